"""Compiled simulation of a car (a two-track model) and its driver.

- Tires have a relaxation length, and their forces stay inside the friction circle (combined slip).
- Motor, brake, rolling resistance and tire force act on each wheel. Anti-lock and traction control reduce the torques
  of a wheel whose slip exceeds the slip at the tire's peak force.
- The body moves in the plane under the tire forces and the air drag. Roll and pitch are second-order responses to the
  accelerations; springs and dampers transfer the load.

Integration: classical Runge-Kutta at 1 kHz. The driver acts at 100 Hz. All kernels are in this file, since Numba's
cache does not detect changes of imported kernels.

Frames: local east-north and body (x forward, y left, z up). Wheels: front left, front right, rear left, rear right.
[P]: H. B. Pacejka, "Tire and Vehicle Dynamics" (similarity method, transient tires, low speed).
"""

import math
from typing import NamedTuple

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached

compiled = cached(nogil=True, error_model="numpy")

GRAVITY = 9.81  # m/s2, as in CARLA
STEP = 0.001  # s, step of the integration
STEPS_PER_DRIVER_STEP = 10  # integration steps per step of the driver
AIR_DENSITY = 1.204  # kg/m3, at 20 deg C and sea level

# Indices of the state. WHEEL, KAPPA and ALPHA are the first of four indices each, one per wheel.
X, Y, YAW, VX, VY, YAW_RATE, STEER, PEDAL, ROLL, ROLL_RATE, PITCH, PITCH_RATE = range(12)
WHEEL, KAPPA, ALPHA = 12, 16, 20
STATES = 24
# Recorded columns: the first twelve states, and the columns below.
AX, AY, YAW_ACCEL, ROLL_ACCEL, PITCH_ACCEL, PEAK_KAPPA, PEAK_ALPHA, FRICTION_USE, REAR_SPIN = range(12, 21)
RECORDED = 21

_LOW_SPEED = 3.0  # m/s; at lower speeds, a damper prevents oscillations of a standing car on its tires [P]
_SMALLEST_STATE = 1e-60  # smaller states become zero, since subnormal numbers are slow
_LOW_SPEED_DAMPING = 0.15  # slip per m/s of sliding, damping at low speed
_BRAKE_VISCOSITY = 1000.0  # N m s/rad; makes the dry friction of a brake continuous at standstill


class Vehicle(NamedTuple):
    """Parameters of a car. Values and sources: `sigmaswarm.simulation.environments`."""

    mass: float  # kg
    yaw_inertia: float  # kg m2
    front: float  # m, center of gravity to front axle
    rear: float  # m, center of gravity to rear axle
    track: float  # m
    height: float  # m, of the center of gravity
    drag_area: float  # m2, drag coefficient times frontal area
    rolling_resistance: float  # force over load
    wheel_radius: float  # m
    wheel_inertia: float  # kg m2, of a wheel and its part of the motors
    slip_stiffness: float  # longitudinal force over load, per unit of slip
    # lateral force over load, per rad, including the compliance of steering and suspension
    cornering_front: float
    cornering_rear: float
    load_sensitivity: float  # relative decrease of the three stiffnesses above at twice the static load
    tire_shape: float  # C of the magic formula
    relaxation_longitudinal: float  # m
    relaxation_lateral: float  # m
    drive_front_share: float
    brake_front_share: float
    roll_front_share: float  # front axle's share of the roll moment
    steer_max: float  # rad, at the road wheel
    steer_rate: float  # rad/s
    steer_lag: float  # s
    pedal_rate: float  # full strokes per s
    pedal_lag: float  # s, of motor and brake together
    roll_gain: float  # rad per m/s2
    roll_frequency: float  # rad/s
    roll_damping: float  # damping ratio
    pitch_gain: float  # rad per m/s2
    pitch_frequency: float  # rad/s
    pitch_damping: float  # damping ratio
    pedal_speed: Array  # m/s, knots of the three maps below
    full_throttle: Array  # m/s2
    coast: Array  # m/s2, both pedals released
    full_brake: Array  # m/s2


class Drivetrain(NamedTuple):
    """Values that are equal for all wheels in a step."""

    tangent: float  # tangent of the steering angle
    peak: float  # slip of the peak force of a tire
    drive: float  # N m, of all motors
    brake: float  # N m, of all brakes
    friction: float


@compiled
def _lookup(x: float, knots: Array, values: Array) -> float:
    """Interpolate linearly; values are constant beyond both ends."""
    if x <= knots[0]:
        return values[0]
    for i in range(1, len(knots)):
        if x < knots[i]:
            before, low = knots[i - 1], values[i - 1]
            return low + (values[i] - low) * (x - before) / (knots[i] - before)
    return values[-1]


@compiled
def _clip(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


@compiled
def _wheel_loads(car: Vehicle, ax: float, ay: float) -> tuple[float, float, float, float]:
    """Return the vertical load of each wheel, N; ``ax`` and ``ay`` (m/s2) act through the suspension."""
    front = car.mass * (GRAVITY * car.rear - car.height * ax) / (car.front + car.rear)
    rear = car.mass * GRAVITY - front
    across = car.mass * car.height * ay / car.track
    at_front = car.roll_front_share * across
    at_rear = across - at_front
    return (
        max(front / 2 - at_front, 0.0),
        max(front / 2 + at_front, 0.0),
        max(rear / 2 - at_rear, 0.0),
        max(rear / 2 + at_rear, 0.0),
    )


@compiled
def _tire(
    kappa: float,
    alpha: float,
    cornering: float,
    load: float,
    static_load: float,
    friction: float,
    car: Vehicle,
) -> tuple[float, float, float, float]:
    """Return the longitudinal and lateral forces (N), and the normalized longitudinal and combined slips, of a tire.

    Similarity method [P]: slips are normalized by stiffness over friction and add as vectors. The magic formula,
    applied to the sum, gives the force, which is at most friction x load.
    """
    stiffness = 1.0 - car.load_sensitivity * (load / static_load - 1.0)
    slip_x = car.slip_stiffness * stiffness * kappa / friction
    slip_y = cornering * stiffness * alpha / friction
    slip = math.hypot(slip_x, slip_y)
    share = 1.0 if slip < 1e-9 else math.sin(car.tire_shape * math.atan(slip / car.tire_shape)) / slip
    force = friction * load * share
    return force * slip_x, force * slip_y, slip_x, slip


@compiled
def _relax(rate: float, deflection: float, sliding: bool) -> float:
    """Return the rate of a tire's deflection; a sliding tire does not deflect further."""
    return 0.0 if sliding and rate * deflection > 0.0 else rate


@compiled
def _torques(s: Array, car: Vehicle) -> tuple[float, float]:
    """Return the total torques (N m) of all motors and all brakes; the car coasts at pedal 0."""
    speed = max(s[VX], 0.0)
    coast = _lookup(speed, car.pedal_speed, car.coast)
    drive = coast + max(s[PEDAL], 0.0) * (_lookup(speed, car.pedal_speed, car.full_throttle) - coast)
    brake = max(-s[PEDAL], 0.0) * (coast - _lookup(speed, car.pedal_speed, car.full_brake))
    # The maps are accelerations of the car with its rotating wheels.
    lever = (car.mass + 4.0 * car.wheel_inertia / car.wheel_radius**2) * car.wheel_radius
    return drive * lever, brake * lever


@compiled
def _spin_up(
    spin: float, slip: float, load: float, force: float, drive: float, brake: float, car: Vehicle
) -> float:
    """Return the angular acceleration (rad/s2) of a wheel under torques (N m) and a tire force (N).

    Idealized anti-lock and traction control reduce the torques linearly, from the full torque at the slip of the peak
    force (``slip`` 1) to 0 at twice this slip.
    """
    control = _clip(2.0 - slip, 0.0, 1.0)
    most = control * brake
    torque = control * drive - _clip(_BRAKE_VISCOSITY * spin, -most, most)
    torque -= car.rolling_resistance * load * car.wheel_radius * spin / math.sqrt(spin * spin + 0.25)
    return (torque - car.wheel_radius * force) / car.wheel_inertia


@compiled
def _wheel(
    i: int, s: Array, rate: Array, load: float, shared: Drivetrain, car: Vehicle
) -> tuple[float, float, float]:
    """Return the force (N, in body axes) and the moment (N m) of wheel i.

    The rates of the wheel's states are filled.
    """
    at_front = i < 2
    axle_x = car.front if at_front else -car.rear
    across = 0.5 * car.track if i % 2 == 0 else -0.5 * car.track
    wheelbase = car.front + car.rear
    # Ackermann: all wheels turn about one point on the line of the rear axle.
    turned = wheelbase * shared.tangent / (wheelbase - across * shared.tangent) if at_front else 0.0
    cos = 1.0 / math.sqrt(1.0 + turned * turned)
    sin = turned * cos

    hub_x = s[VX] - s[YAW_RATE] * across
    hub_y = s[VY] + s[YAW_RATE] * axle_x
    roll_speed = cos * hub_x + sin * hub_y
    side_speed = cos * hub_y - sin * hub_x
    slide_speed = car.wheel_radius * s[WHEEL + i] - roll_speed

    damping = _LOW_SPEED_DAMPING * max(0.0, 1.0 - abs(roll_speed) / _LOW_SPEED)
    kappa, alpha = s[KAPPA + i], s[ALPHA + i]
    fx, fy, slip_x, slip = _tire(
        kappa + damping * slide_speed,
        alpha - damping * side_speed,
        car.cornering_front if at_front else car.cornering_rear,
        load,
        0.5 * car.mass * GRAVITY * (car.rear if at_front else car.front) / wheelbase,
        shared.friction,
        car,
    )
    sliding = slip > 3.0 * shared.peak
    travel = abs(roll_speed)
    # The slip of the tire follows the slip of the wheel over the relaxation length [P].
    kappa_rate = (slide_speed - travel * kappa) / car.relaxation_longitudinal
    alpha_rate = (-side_speed - travel * alpha) / car.relaxation_lateral
    rate[KAPPA + i] = _relax(kappa_rate, kappa, sliding)
    rate[ALPHA + i] = _relax(alpha_rate, alpha, sliding)
    drive = shared.drive * (0.5 * (car.drive_front_share if at_front else 1.0 - car.drive_front_share))
    brake = shared.brake * (0.5 * (car.brake_front_share if at_front else 1.0 - car.brake_front_share))
    rate[WHEEL + i] = _spin_up(s[WHEEL + i], abs(slip_x) / shared.peak, load, fx, drive, brake, car)

    force_x = cos * fx - sin * fy
    force_y = sin * fx + cos * fy
    return force_x, force_y, axle_x * force_y - across * force_x


@compiled
def _swing(target: float, value: float, rate: float, frequency: float, damping: float) -> float:
    return frequency**2 * (target - value) - 2.0 * damping * frequency * rate


@compiled
def _derivative(
    s: Array, rate: Array, steer: float, pedal: float, friction: float, car: Vehicle
) -> tuple[float, float, float]:
    """Fill `rate` with the derivative of the state under the desired steering (rad) and pedal.

    Return the acceleration of the center of gravity in body axes (m/s2), and total tire force / (friction x weight).
    """
    vx, vy, yaw_rate = s[VX], s[VY], s[YAW_RATE]
    # The springs and dampers transmit the load transfer.
    loads = _wheel_loads(
        car,
        s[PITCH] + 2.0 * car.pitch_damping / car.pitch_frequency * s[PITCH_RATE],
        s[ROLL] + 2.0 * car.roll_damping / car.roll_frequency * s[ROLL_RATE],
    )
    drive, brake = _torques(s, car)
    peak = car.tire_shape * math.tan(0.5 * math.pi / car.tire_shape)  # slip at the peak of the magic formula
    shared = Drivetrain(math.tan(s[STEER]), peak, drive, brake, friction)
    force_x = force_y = moment = 0.0
    for i in range(4):
        fx, fy, m = _wheel(i, s, rate, loads[i], shared, car)
        force_x += fx
        force_y += fy
        moment += m
    drag = 0.5 * AIR_DENSITY * car.drag_area * math.hypot(vx, vy)
    ax = (force_x - drag * vx) / car.mass
    ay = (force_y - drag * vy) / car.mass

    cos, sin = math.cos(s[YAW]), math.sin(s[YAW])
    rate[X] = cos * vx - sin * vy
    rate[Y] = sin * vx + cos * vy
    rate[YAW] = yaw_rate
    rate[VX] = ax + yaw_rate * vy
    rate[VY] = ay - yaw_rate * vx
    rate[YAW_RATE] = moment / car.yaw_inertia
    rate[STEER] = _clip((steer - s[STEER]) / car.steer_lag, -car.steer_rate, car.steer_rate)
    rate[PEDAL] = _clip((pedal - s[PEDAL]) / car.pedal_lag, -car.pedal_rate, car.pedal_rate)
    # Roll and pitch are stored as the constant acceleration (m/s2) that would cause them.
    rate[ROLL] = s[ROLL_RATE]
    rate[ROLL_RATE] = _swing(ay, s[ROLL], s[ROLL_RATE], car.roll_frequency, car.roll_damping)
    rate[PITCH] = s[PITCH_RATE]
    rate[PITCH_RATE] = _swing(ax, s[PITCH], s[PITCH_RATE], car.pitch_frequency, car.pitch_damping)
    return ax, ay, math.hypot(force_x, force_y) / (friction * car.mass * GRAVITY)


@compiled
def _record(row: Array, s: Array, rate: Array, ax: float, ay: float, use: float) -> None:
    row[:12] = s[:12]
    row[AX], row[AY], row[FRICTION_USE] = ax, ay, use
    row[YAW_ACCEL], row[ROLL_ACCEL], row[PITCH_ACCEL] = rate[YAW_RATE], rate[ROLL_RATE], rate[PITCH_RATE]
    row[REAR_SPIN] = 0.5 * (s[WHEEL + 2] + s[WHEEL + 3])
    row[PEAK_KAPPA] = row[PEAK_ALPHA] = 0.0
    for i in range(4):
        row[PEAK_KAPPA] = max(row[PEAK_KAPPA], abs(s[KAPPA + i]))
        row[PEAK_ALPHA] = max(row[PEAK_ALPHA], abs(s[ALPHA + i]))


@compiled
def _advance(
    s: Array, k: Array, row: Array, steer: float, pedal: float, friction: float, car: Vehicle
) -> None:
    """Do one Runge-Kutta step in place. `row` records the state before the step, and `k` (5, states) is work space."""
    trial = k[4]
    ax, ay, use = _derivative(s, k[0], steer, pedal, friction, car)
    _record(row, s, k[0], ax, ay, use)
    for stage in range(1, 4):
        h = STEP if stage == 3 else 0.5 * STEP
        for i in range(STATES):
            trial[i] = s[i] + h * k[stage - 1, i]
        _derivative(trial, k[stage], steer, pedal, friction, car)
    for i in range(STATES):
        s[i] += STEP / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
        if abs(s[i]) < _SMALLEST_STATE:
            s[i] = 0.0
    s[STEER] = _clip(s[STEER], -car.steer_max, car.steer_max)


@compiled
def start_state(x: float, y: float, yaw: float, speed: float, car: Vehicle) -> Array:
    """Return the state (24,) of a car that rolls straight ahead at `speed`, m/s."""
    s = np.zeros(STATES)
    s[X], s[Y], s[YAW], s[VX] = x, y, yaw, speed
    s[WHEEL : WHEEL + 4] = speed / car.wheel_radius
    return s


@compiled
def run_open_loop(car: Vehicle, friction: float, start: Array, steer: Array, pedal: Array) -> Array:
    """Drive from a `start_state` with one command per millisecond. Return the record (n, 21).

    ``steer`` (n,) is the desired angle of the road wheels, rad. ``pedal`` (n,) is -1 (full brake) to 1.
    """
    record = np.empty((len(steer), RECORDED))
    k, s = np.zeros((5, STATES)), start.copy()
    for i in range(len(steer)):
        _advance(s, k, record[i], steer[i], pedal[i], friction, car)
    return record


@compiled
def _steer(s: Array, path: Array, spacing: float, nearest: int, car: Vehicle) -> tuple[float, int, float]:
    """Return the desired steering angle (rad), the index of the nearest point, and the distance along the path, m.

    The angle is the sum of a feedforward from the curvature ahead and a feedback. The feedback makes a lateral
    offset from the path decay like a damped oscillator with the angular frequency speed / (5 m), limited to 1.5 rad/s.
    """
    while nearest < len(path) - 2:
        dx, dy = s[X] - path[nearest + 1, 0], s[Y] - path[nearest + 1, 1]
        if dx * math.cos(path[nearest + 1, 2]) + dy * math.sin(path[nearest + 1, 2]) < 0.0:
            break
        nearest += 1
    cos, sin = math.cos(path[nearest, 2]), math.sin(path[nearest, 2])
    dx, dy = s[X] - path[nearest, 0], s[Y] - path[nearest, 1]
    beyond = dx * cos + dy * sin
    offset = dy * cos - dx * sin

    speed = max(s[VX], 0.1)
    course = s[YAW] + math.atan2(s[VY], max(s[VX], 1.0)) - path[nearest, 2] - beyond * path[nearest, 3]
    course -= 2.0 * math.pi * math.floor(course / (2.0 * math.pi) + 0.5)
    ahead = nearest + int((beyond + speed * (car.steer_lag + 0.05)) / spacing)
    curvature = path[min(ahead, len(path) - 1), 3]

    wheelbase = car.front + car.rear
    understeer = (1.0 / car.cornering_front - 1.0 / car.cornering_rear) / GRAVITY  # rad per m/s2
    effective = wheelbase + understeer * speed**2
    frequency = min(1.5, speed / 5.0)
    per_meter = effective * (frequency / speed) ** 2
    per_radian = 2.0 * 0.8 * effective * frequency / speed
    angle = effective * curvature - per_meter * offset - per_radian * course
    return _clip(math.atan(angle), -car.steer_max, car.steer_max), nearest, nearest * spacing + beyond


@compiled
def _press(s: Array, now: Array, soon: Array, gone: float, car: Vehicle) -> float:
    """Return the desired pedal, -1 to 1; ``now`` and ``soon`` are rows of the plan."""
    if soon[0] < 0.02 and abs(s[VX]) < 0.3:
        return -0.25  # hold the car with the brake
    speed = max(s[VX], 0.0)
    wanted = soon[1] + 4.0 * (now[0] - s[VX]) + 0.3 * _clip(now[2] - gone, -2.0, 2.0)
    wanted += car.rolling_resistance * GRAVITY + 0.5 * AIR_DENSITY * car.drag_area * speed**2 / car.mass
    coast = _lookup(speed, car.pedal_speed, car.coast)
    if wanted > coast:
        return min((wanted - coast) / (_lookup(speed, car.pedal_speed, car.full_throttle) - coast), 1.0)
    return max((wanted - coast) / (coast - _lookup(speed, car.pedal_speed, car.full_brake)), -1.0)


@compiled
def run_closed_loop(
    car: Vehicle, friction: float, start: Array, path: Array, spacing: float, plan: Array
) -> Array:
    """Let the driver follow a path and a plan from a `start_state`. Return the record (10 k, 21), one row per ms.

    ``path`` (p, 4) contains, every ``spacing`` m, east (m), north (m), heading (rad, not wrapped) and curvature (1/m).

    ``plan`` (k, 3) contains, every 10 ms, speed (m/s), acceleration (m/s2) and distance along the path (m).
    """
    record = np.empty((len(plan) * STEPS_PER_DRIVER_STEP, RECORDED))
    k, s, nearest = np.zeros((5, STATES)), start.copy(), 0
    lead = round(car.pedal_lag / (STEP * STEPS_PER_DRIVER_STEP))
    for look in range(len(plan)):
        steer, nearest, gone = _steer(s, path, spacing, nearest, car)
        pedal = _press(s, plan[look], plan[min(look + lead, len(plan) - 1)], gone, car)
        for i in range(STEPS_PER_DRIVER_STEP):
            _advance(s, k, record[look * STEPS_PER_DRIVER_STEP + i], steer, pedal, friction, car)
    return record
