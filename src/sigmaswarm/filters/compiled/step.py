"""One step of LANES filters, the same in a run and in a live filter: predict, then absorb what there is."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from sigmaswarm.filters.compiled.lanes import LANES, kernel
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.compiled.measurements import absorbers
from sigmaswarm.filters.compiled.planar5 import predict_planar5
from sigmaswarm.filters.compiled.planar8 import predict_planar8
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.schedule import (
    FIX,
    GAP_ACCELERATION_STD,
    GAP_TURN_STD,
    HIDDEN,
    LATERAL,
    STANDSTILL,
    VELOCITY,
)


@kernel
def _grow(w, dt, gap):
    """What nobody saw in a gap of the IMU's samples: `schedule.gap_covariance`."""
    turn = GAP_TURN_STD * GAP_TURN_STD * gap * dt
    g = GAP_ACCELERATION_STD * GAP_ACCELERATION_STD * gap * dt
    for l in range(LANES):
        w[R.XX, l] += 0.25 * g * dt * dt
        w[R.YY, l] += 0.25 * g * dt * dt
        w[R.XU, l] += 0.5 * g * dt
        w[R.YV, l] += 0.5 * g * dt
        w[R.UU, l] += g
        w[R.VV, l] += g
        w[R.TT, l] += turn


def _step(
    w, dt, ax, ay, gz, q_scale, gap, happens, zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since,
    *, predict, absorb_fix, forecast_fix, absorb_velocity, absorb_lateral, absorb_standstill,
):  # fmt: skip
    """``happens`` are the bits of `schedule`; zx, ..., var_y a fix; ``since`` is Q's scale since the last one.

    ``gap`` is as in `Timeline.steps`.
    """
    if dt > 0.0:
        predict(w, dt, ax, ay, gz, q_scale)
        if gap > 0.0:
            _grow(w, dt, gap)
    if happens & FIX:
        absorb_fix(w, zx, zy, var_x, var_y, lever_x, lever_y, since)
        if happens & VELOCITY:
            absorb_velocity(w, zu, zv)
    if happens & HIDDEN:
        forecast_fix(w, zx, zy, var_x, var_y, lever_x, lever_y)
    if happens & LATERAL:
        absorb_lateral(w, gz)
    if happens & STANDSTILL:
        absorb_standstill(w, gz)


step5 = kernel(_step, predict=predict_planar5, **absorbers(MODELS["planar5"]))
step8 = kernel(_step, predict=predict_planar8, **absorbers(MODELS["planar8"]))
