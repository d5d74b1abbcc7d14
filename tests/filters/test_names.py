"""Kernels of different models must not have the same name in a process, since one could replace the other."""

from sigmaswarm.filters.compiled import run, step
from sigmaswarm.filters.compiled.single import single_step
from sigmaswarm.filters.compiled.unroll import Kernel, unrolled
from sigmaswarm.filters.kernels import FILTERS


def _scaled(w, *, n, inner):
    return inner(w) * n


def _doubled(w, *, k):
    return w * k


def test_unrolled_forms_of_one_function_have_different_names():
    two, three = (unrolled(_doubled, k=k) for k in (2, 3))
    assert two(1) == 2
    assert two.__qualname__ != three.__qualname__
    outer = {unrolled(_scaled, n=n, inner=f).__qualname__ for n in (1, 2) for f in (two, three)}
    assert len(outer) == 4
    assert unrolled(_doubled, k=2).__qualname__ == two.__qualname__, "the name is the same in every process"


def test_kernels_of_models_have_different_names():
    made = [[of(name) for name in FILTERS] for of in (step.step_of, run.run_kernel)]
    for each in made:
        names = [
            one.name if isinstance(one, Kernel) else getattr(one, "py_func", one).__qualname__ for one in each
        ]
        assert len({*names}) == len(names), names
    steps = {single_step(model).address for model in ("planar5", "planar8")}
    assert len(steps) == 2
