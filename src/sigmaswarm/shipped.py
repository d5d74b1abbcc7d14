"""Kernels that a wheel brings along: compiled by Numba, and left to LLVM on the machine that runs them.

Five sixths of what it takes to compile a kernel are Numba's: types, and instructions for LLVM. Those depend on the
versions of Python, Numba and LLVM, on the sources, and on how many lanes go side by side; not on the processor, whose
own instructions LLVM chooses then. So the wheel's build compiles each kernel that far, for both widths (in
`hatch_build.py`), and here LLVM does the rest, in the same passes, for the same bits. What does not match, as in a
checkout, is compiled.
"""

# Numba has types of its own, which a type checker for Python does not know.
# pyright: basic, reportAttributeAccessIssue=false

import hashlib
import pickle
import sys
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import llvmlite
import numba
from llvmlite import binding as llvm
from numba.core.serialize import dumps

KERNELS = Path(__file__).with_name("kernels.zip")


def wide(codegen: Any) -> bool:
    """Whether the processor's vectors hold eight numbers; else four."""
    return "+avx512f" in codegen.magic_tuple()[2]


def key_of(name: str, signature: Any, codegen: Any) -> str:
    """What a kernel is called in the file: a hash of all that its code depends on.

    ``name`` tells it from all others of these sources.
    """
    target = codegen.magic_tuple()[0], str(codegen.target_data), wide(codegen)
    made_by = sys.implementation.cache_tag, numba.__version__, llvmlite.__version__, llvm.llvm_version_info
    return hashlib.sha256(repr((made_by, target, _sources(), name, str(signature))).encode()).hexdigest()


@cache
def _sources() -> str:
    """A hash of the whole package."""
    digest, package = hashlib.sha256(), Path(__file__).parent
    for file in sorted(package.rglob("*.py")):
        digest.update(
            f"{file.relative_to(package).as_posix()} {file.stat().st_size} ".encode() + file.read_bytes()
        )
    return digest.hexdigest()


def packed(library: str, bitcode: bytes, about: tuple[Any, ...]) -> bytes:
    """A kernel as the file holds it, with its checksum: its library's name and code, and what Numba says about it."""
    content = dumps((library, bitcode, about))
    return hashlib.sha256(content).digest() + content


def brought(key: str, codegen: Any) -> tuple[Any, ...] | None:
    """A kernel of the file in the form in which Numba keeps it, compiled for this processor; None if there is none."""
    try:
        with ZipFile(KERNELS) as file:
            content = file.read(key)
    except (OSError, KeyError, BadZipFile):
        return None
    if hashlib.sha256(content[32:]).digest() != content[:32]:
        return None
    name, bitcode, about = pickle.loads(content[32:])
    return (_finished(name, bitcode, codegen), *about)


def _finished(name: str, bitcode: bytes, codegen: Any) -> tuple[str, str, tuple[bytes, bytes]]:
    """A library as Numba keeps it: with its machine code, and its instructions for whoever calls it."""
    library = codegen.create_library(name)
    library._final_module.link_in(llvm.parse_bitcode(bitcode))
    library._optimize_final_module()
    module = library._final_module
    module.verify()
    code = codegen._tm.emit_object(module)
    for function in module.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.linkage = "linkonce_odr"  # may be there several times
    return name, "object", (code, module.as_bitcode())
