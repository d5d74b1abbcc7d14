"""One step of LANES filters: predict, then update with the measurements."""

from functools import cache

from sigmaswarm.drives.events import COMPARED, FIX, HEADING, HIDDEN, LATERAL, ODOMETER, STANDSTILL, VELOCITY
from sigmaswarm.drives.timeline import DT, GAP
from sigmaswarm.filters.compiled import robot_localization, transition
from sigmaswarm.filters.compiled.adaptive import carry_fix_error
from sigmaswarm.filters.compiled.lanes import kernel
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.compiled.measurements import measurement_kernels
from sigmaswarm.filters.compiled.planar5 import predict_planar5
from sigmaswarm.filters.compiled.planar8 import predict_planar8
from sigmaswarm.filters.compiled.tilted12 import COLUMNS, predict_tilted12, propagate, settle
from sigmaswarm.filters.compiled.tilted12_unscented import add_curvature, linearize
from sigmaswarm.filters.compiled.transition import COEFFICIENTS, TRANSITIONS
from sigmaswarm.filters.constants import GAP_ACCELERATION_STD, GAP_TILT_STD, GAP_TURN_STD
from sigmaswarm.filters.kernels import FILTERS, UNSCENTED, base_model_name
from sigmaswarm.filters.tilted import N


def _grow(w, dt, gap, *, tilted):
    """Add the covariance of the unobserved motion in an IMU gap.

    See `constants.gap_covariance`.
    """
    turn = GAP_TURN_STD * GAP_TURN_STD * gap * dt
    g = GAP_ACCELERATION_STD * GAP_ACCELERATION_STD * gap * dt
    for l in range(LANES):
        w.XX += 0.25 * g * dt * dt
        w.YY += 0.25 * g * dt * dt
        w.XU += 0.5 * g * dt
        w.YV += 0.5 * g * dt
        w.UU += g
        w.VV += g
        w.TT += turn
        if tilted:
            w.II += GAP_TILT_STD * GAP_TILT_STD * gap * dt
            w.JJ += GAP_TILT_STD * GAP_TILT_STD * gap * dt


def _step(
    w, u, events, z, wheels, lever, since,
    *, predict, carry, grow, settle, note_move, note_prior,
    update_fix, forecast_fix, update_velocity, update_lateral, update_odometer, update_standstill,
    update_heading,
):  # fmt: skip
    """Predict, and update with the measurements.

    ``u`` (DT ... GY of a step), ``z`` (a row of `Timeline.fixes`) and ``wheels`` (a row of `Events.wheels`) are tuples.
    ``events`` contains the bits of `drives.events`, ``lever`` is the lever arm of the timeline (m) and ``since`` is
    the time since the last fix, in nominal steps.
    """
    dt, gap = u[DT], u[GAP]
    if dt > 0.0:
        predict(w, u)
        if carry:
            carry(w, u)
        if gap > 0.0:
            grow(w, dt, gap)
    if note_prior:
        note_move(w, dt)
        note_prior(w)
    if events & FIX:
        update_fix(w, z, lever, since)
        if events & VELOCITY:
            update_velocity(w, z)
        if events & HEADING:
            update_heading(w, u, z)
    if events & HIDDEN:
        forecast_fix(w, z, lever, since)
    if events & LATERAL:
        update_lateral(w, u)
    if events & ODOMETER:
        update_odometer(w, u, wheels)
    if events & STANDSTILL:
        update_standstill(w, u)
    if settle:  # noqa: SIM102 (``settle`` is known at compilation)
        if events & COMPARED:
            settle(w)


def _predict_tilted12(name, columns=COLUMNS, **known):
    moved = kernel(propagate, columns=columns, coefficients=COEFFICIENTS[name], transition=TRANSITIONS[name])
    return kernel(predict_tilted12, propagate=moved, **{"linearize": None, "add_curvature": None} | known)


_PREDICTIONS = {
    "planar5": (predict_planar5, None),
    "planar8": (predict_planar8, None),
    "tilted12": (_predict_tilted12("tilted12"), settle),
    "tilted12+fix-error": (_predict_tilted12("tilted12", (*COLUMNS, (N, N + 1))), settle),
    UNSCENTED: (_predict_tilted12(UNSCENTED, linearize=linearize, add_curvature=add_curvature), settle),
}


@cache
def step_of(name, *, noted=False):
    """Return the step of the kernel ``name`` for LANES filters, as a function that callers inline.

    If ``noted`` is True, also write the inputs of a smoother to scratch rows (see `transition`).
    """
    model = FILTERS[name]
    if model.measures_imu:
        return robot_localization.step
    predict, settle = _PREDICTIONS.get(name) or _PREDICTIONS[base_model_name(name)]
    carries = model.fix_error and not model.tilts  # tilted12's prediction propagates these errors
    note_prior = transition.note_prior(name) if noted else None
    return kernel(
        _step,
        predict=predict,
        carry=kernel(carry_fix_error, n=len(model.states), biases=int(bool(model.sensors)))
        if carries
        else None,
        settle=settle,
        note_move=transition.note_move(name) if noted else None,
        note_prior=note_prior,
        grow=kernel(_grow, tilted=int(model.tilts)),
        **measurement_kernels(name, note_prior, transition.phi_index(name) if noted else 0),
    )
