"""Compare stated standard deviations with the fixes; find correlated errors, outliers and multipath.

The stated standard deviation is that of the receiver (std_x, std_y), or gps_std_m in drive.toml.
"""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.acceleration_fit import MIN_NOISE
from sigmaswarm.doctor.evidence import MAX_SCATTER_RATIO, Evidence
from sigmaswarm.doctor.findings import NO_ACTION, Finding, Repair, confidence_of, split_command
from sigmaswarm.drives.sensors import assumes_std, motion_in_noise, receiver_std, stated_std

MAX_OBSERVED_RATIO = 2.0  # largest ratio of observed noise to stated noise
# m, standard deviation that no receiver reaches in motion (data sheets of RTK state 0.006 to 0.01 m). A smaller
# deviation is compared with the noise from fix to fix, since the scatter about a path of 10 s includes IMU errors.
MIN_STATED_STD = 0.003
# Largest ratio of stated noise to observed white noise; high, since slowly varying errors are not observed
MAX_STATED_RATIO = 6.5
# Largest ratio of the errors relative to the truth to the stated noise, or of the stated noise to these errors; high,
# since a short drive may have one error that lasts
MAX_ERROR_RATIO = 3.5
MAX_TYPED_RATIO = 3.0  # as MAX_STATED_RATIO, for a value in drive.toml
# m, largest distance of the first fix from the others; a farther first fix displaces the drive's origin
MAX_FIRST_DISTANCE = 1000.0
# Ratio of the noise from fix to fix to the scatter about a path of 10 s; larger ratios show white noise, whose ratio is
# 1
MIN_WHITE_RATIO = 0.7
# Largest ratio of the noise from fix to fix in two successive windows to the lower quartile of all windows; a larger
# one shows a disturbance. White noise at 1 Hz reaches 2.2 in drives of 300 s, noise of a t-distribution (3 dof) 3.4.
MAX_NOISE_RATIO = 4.0
MIN_DISTURBANCE = 0.1  # m, smallest noise of a disturbance


def check_noise(evidence: Evidence) -> Iterator[Finding]:
    yield from _stated(evidence)
    yield from _disturbed(evidence)
    gps, off = evidence.drive.gps, evidence.outlying
    time = gps.time[off]
    if not len(time):
        return
    first = ", ".join(f"{t:.1f}" for t in time[:4]) + (" ..." if len(time) > 4 else "")
    lie = "fixes lie" if len(time) > 1 else "fix lies"
    share, then = 100 * len(time) / len(gps), int(evidence.used[0])
    what = f"{len(time)} {lie} far from the path ({share:.1f}% of all), at t = {first} s"
    severity, jump = "warning", float(np.hypot(gps.x[then] - gps.x[0], gps.y[then] - gps.y[0]))
    if off[0] and jump > MAX_FIRST_DISTANCE:
        severity, what = "serious", f"{what}; the first fix lies {jump / 1e3:.3g} km from the others"
    span, repair = (float(time[0]), float(time[-1])), Repair("drop-fixes", tuple(time.tolist()))
    remedy = "omit these fixes. The default filter of tune also reduces their weight (robust)"
    yield Finding("gps-outliers", severity, what, "gps.csv, positions", span, 0.99, remedy, repair)


def _disturbed(evidence: Evidence) -> Iterator[Finding]:
    """Find windows in which successive fixes differ from the IMU's path far more than elsewhere."""
    fit, course, stated = evidence.acceleration, evidence.course, evidence.drive.gps.std_x
    if fit is None or course is None:
        return
    size = np.median(np.abs(np.diff(fit.residual, n=2, axis=1)), axis=1) / np.sqrt(12 * np.log(2))
    usual = float(np.quantile(size, 0.25))
    high = np.pad(size > max(MAX_NOISE_RATIO * usual, MIN_DISTURBANCE), 1)
    high = high[1:-1] & (high[:-2] | high[2:])  # one window may contain an outlier
    if not high.any():
        return
    fixes, noise = np.unique(fit.rows[high]), float(np.median(size[high]))
    if stated is not None:
        std = stated[evidence.used]
        if np.mean(std[fixes]) / np.median(std) > noise / usual / MAX_OBSERVED_RATIO:
            return  # the receiver states this itself, and filters use it
    part = slice(int(np.argmax(high)), len(high) - int(np.argmax(high[::-1])))
    moved, off = np.diff(course.position[fit.rows[part]], axis=1), np.diff(fit.residual[part], axis=1)
    turn = np.degrees(np.max(np.abs(np.angle(moved * np.conj(moved - off)))))
    duration = (len(fixes) - 1) * course.interval
    start, end = float(course.time[fixes[0]]), float(course.time[fixes[-1]])
    what = (
        f"for {duration:.0f} of the {end - start:.0f} s from t = {start:.0f} s, the fixes scatter by {noise:.2g} m per "
        f"axis from fix to fix, {noise / usual:.0f} times as much as in the quiet parts."
        f" Their course differs by up to {turn:.0f} deg from that of the IMU. "
        "Multipath at buildings or trees has this effect"
    )
    command = split_command(start, end)
    remedy = (
        f"{NO_ACTION} with the default filter of tune (robust), which reduces the weight of such fixes; for "
        f"other filters, cut this part out of the drive: {command}"
    )
    where, span = "gps.csv, positions", (start, end)
    yield Finding(
        "gps-disturbed", "warning", what, where, span, 0.99, remedy, command=command, needs_action=False
    )


def _stated(evidence: Evidence) -> Iterator[Finding]:
    gps, known = evidence.drive.gps, stated_std(evidence.drive)
    noise, scatter = evidence.noise, max(evidence.scatter, evidence.noise)
    if not scatter:
        return
    if known is None:
        assumed = float(np.mean(receiver_std(evidence.drive)))
        or_scatter = ", or the scatter if this clearly reduces the drift of the baseline filter"
        what = (
            f"the receiver states no accuracy. The fixes scatter by {scatter:.2g} m per axis. Their standard "
            "deviation may be larger, since slowly varying errors do not increase the scatter. Tuning without truth "
            f"assumes {assumed:.2g} m{or_scatter if assumes_std(evidence.drive) else ''}"
        )
        remedy = "if you know a better value, write gps_std_m at the top of drive.toml"
        yield Finding("gps-noise", "note", what, "drive.toml, gps_std_m", evidence.span, 0.95, remedy)
        return
    stated, unseen = float(np.mean(known)), motion_in_noise(gps.interval)
    if stated < MIN_STATED_STD:
        scatter, unseen = noise, 0.0
    if wrong := _wrong_std(evidence, stated, scatter, unseen):
        yield _wrongly_stated(evidence, stated, *wrong)
    elif stated > MAX_SCATTER_RATIO * max(scatter, MIN_NOISE) or (
        noise < MIN_WHITE_RATIO * scatter and scatter > MIN_NOISE
    ):
        large = stated > MAX_SCATTER_RATIO * scatter
        otherwise = ", or their stated standard deviation is too large" if large else ""
        what = (
            f"the errors of the fixes are correlated{otherwise}. Per axis, the standard deviation of the white noise "
            f"from fix to fix is {noise:.2g} m, and that of the residuals from smooth paths fitted over ten seconds is "
            f"{scatter:.2g} m; the stated standard deviation is {stated:.2g} m. Averaging hardly reduces correlated "
            "errors. If there is no truth, neither the stated standard deviation nor a filter's error can be checked"
        )
        remedy = (
            "expect errors larger than the filter's standard deviations, which represent only the scatter"
        )
        confidence = confidence_of(stated / scatter)
        yield Finding("gps-correlated", "note", what, _place(evidence), evidence.span, confidence, remedy)


def _place(evidence: Evidence) -> str:
    return "drive.toml, gps_std_m" if evidence.drive.gps.std_x is None else "gps.csv, std_x, std_y"


def _wrong_std(
    evidence: Evidence, stated: float, scatter: float, unseen: float
) -> tuple[float, bool, float] | None:
    """Compare the stated standard deviation with scatter and truth. ``unseen`` is the noise that may be motion, m.

    Return the standard deviation of the fixes, m per axis, True if it is from the truth, and the confidence.
    """
    noise, fit = evidence.noise, evidence.truth_fit
    # A receiver that smooths has correlated errors, so its stated accuracy may be right despite little scatter.
    white = noise > MIN_WHITE_RATIO * scatter and scatter > MIN_NOISE
    error, variation = (fit.error, fit.variation) if fit else (0.0, 0.0)
    if variation < MIN_WHITE_RATIO * noise:  # the truth follows the fixes
        error = variation = 0.0
    limit = MAX_TYPED_RATIO if evidence.drive.gps.std_x is None else MAX_STATED_RATIO
    if noise - unseen > MAX_OBSERVED_RATIO * stated:
        return scatter, False, confidence_of(3 + noise / stated / MAX_OBSERVED_RATIO)
    if white and stated > max(limit * scatter, MAX_ERROR_RATIO * variation):
        by_truth = variation > MAX_SCATTER_RATIO * scatter
        confidence = confidence_of(2 * stated / MAX_STATED_RATIO / scatter)
        return variation if by_truth else scatter, by_truth, confidence
    if variation > MAX_ERROR_RATIO * stated:
        return variation, True, confidence_of(2 * variation / MAX_ERROR_RATIO / stated)
    if error and stated > MAX_STATED_RATIO * max(error, noise):
        return max(error, noise), True, confidence_of(2 * stated / MAX_STATED_RATIO / error)
    return None


def _wrongly_stated(
    evidence: Evidence, stated: float, size: float, by_truth: bool, confidence: float
) -> Finding:
    larger = stated > size
    compared = "errors relative to the truth" if by_truth else "scatter"
    what = (
        f"the stated standard deviation of the fixes ({stated:.2g} m) is {'larger' if larger else 'smaller'} than "
        f"their {compared} ({size:.2g} m per axis) by a factor of {max(stated / size, size / stated):.0f}"
    )
    typed = evidence.drive.gps.std_x is None
    scaled = f"scale std_x and std_y in gps.csv to a median of {size:.2g} m"
    remedy = f"set gps_std_m in drive.toml to {size:.2g} m" if typed else scaled
    repair, severity = Repair("state-noise", (size,)), "warning"
    if not by_truth:
        remedy += (
            ", or more if you know of slowly varying errors. A log without truth does not show these errors"
        )
    elif not larger:  # the lever arm of the antenna may be missing
        repair, remedy = None, f"check the lever arm of the antenna; if it is right, {remedy}"
    if typed:
        what += ". Tuning without truth takes R from this value: with a smaller value the filter follows the fixes "
        what += "more closely, and with a larger value it relies on the IMU for longer"
        if larger and not by_truth:  # a user may know of slowly varying errors
            repair, severity = None, "note"
            remedy = (
                "keep this value if the data sheet of the receiver states it, since slowly varying errors do not "
                "increase the scatter"
            )
    return Finding("gps-noise", severity, what, _place(evidence), evidence.span, confidence, remedy, repair)
