"""One sample at a time, for one filter: the same kernels on a state that is kept between calls.

The state is the first lane of the rows in `lanes`, shape (N_ROWS,). Each call spreads it over all lanes, which costs
less than another set of kernels would.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from sigmaswarm.filters.compiled.lanes import LANES, N_ROWS, kernel
from sigmaswarm.filters.compiled.measurements import absorbers
from sigmaswarm.filters.compiled.planar5 import predict_planar5
from sigmaswarm.filters.compiled.planar8 import predict_planar8
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.run import FIX, LATERAL, STANDSTILL, VELOCITY, cached_by_sources
from sigmaswarm.filters.compiled.unroll import unrolled


def _step(
    w, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, lever_x, lever_y, since,
    *, predict, absorb_fix, forecast_fix, absorb_velocity, absorb_lateral, absorb_standstill,
):  # fmt: skip
    """Predict, then absorb what happens at the step's end (bits as in `run`)."""
    if dt > 0.0:
        predict(w, dt, ax, ay, gz, q_scale)
    if happens & FIX:
        absorb_fix(w, zx, zy, lever_x, lever_y, since)
        if happens & VELOCITY:
            absorb_velocity(w, zu, zv)
    if happens & LATERAL:
        absorb_lateral(w, gz)
    if happens & STANDSTILL:
        absorb_standstill(w, gz)


_step5 = kernel(unrolled(_step, predict=predict_planar5, **absorbers(5)))
_step8 = kernel(unrolled(_step, predict=predict_planar8, **absorbers(8)))


@cached_by_sources
def live_step(sources):
    def step(v, n, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, lever_x, lever_y, since):
        """One step of one filter; v (N_ROWS,) is its state before and after."""
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        for r in range(N_ROWS):
            for l in range(LANES):
                w[r, l] = v[r]
        if n == 5:
            _step5(w, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, lever_x, lever_y, since)
        else:
            _step8(w, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, lever_x, lever_y, since)
        for r in range(N_ROWS):
            v[r] = w[r, 0]

    return step
