"""Execute notebooks in fresh kernels and store their outputs: `make notebook`.

    python examples/execute.py examples/paper.ipynb

The stored outputs contain nothing that changes from run to run: no times, paths or version of Python.
"""

import os
import sys
import tempfile
from pathlib import Path


def execute(path: Path) -> None:
    """Execute a notebook and write its outputs into it; a cell that fails ends the program, and nothing is written."""
    import nbformat
    from nbclient import NotebookClient
    from traitlets.config import Config

    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count, cell.metadata = [], None, {}
    # Sockets in the file system, to which no other user of the machine can listen.
    config = Config({} if os.name == "nt" else {"KernelManager": {"transport": "ipc"}})
    options = {"record_timing": False, "coalesce_streams": True, "timeout": 3600, "kernel_name": "python3"}
    NotebookClient(notebook, config=config, **options).execute()
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    nbformat.write(notebook, path)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        # The kernel writes its history and connection files here, and reads no settings of the user.
        os.environ |= {
            f"{name}_DIR": scratch for name in ("JUPYTER_CONFIG", "JUPYTER_RUNTIME", "JUPYTER_DATA")
        }
        os.environ |= {"IPYTHONDIR": scratch, "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
        for argument in sys.argv[1:]:
            execute(Path(argument))
