"""Custom models used by several test files: a pendulum, and a point on a line."""

import numpy as np

from sigmaswarm import Log, Model, Tunable

GRAVITY = 9.81


def swing(state, dt, u, p):
    rate = state[1] - GRAVITY / p.length * np.sin(state[0]) * dt
    return np.array([state[0] + rate * dt, rate])


def angle(state, p):
    return state[:1]


PENDULUM = Model(
    "pendulum",
    states=("angle", "rate"),
    f=swing,
    h=angle,
    parameters=(
        Tunable("length", 0.2, 3.0, logarithmic=False, unit="m"),
        Tunable("q_rate", 1e-8, 1.0, unit="rad2/s3"),
        Tunable("r_angle", 1e-6, 1.0, unit="rad2"),
    ),
    process_noise=lambda dt, p: np.array([1e-12, p.q_rate]) * dt,
    measurement_noise=lambda p: np.array([p.r_angle]),
    angles=("angle",),
    measured_angles=(0,),
)
SCALING = {"alpha": 0.5, "beta": 2.0, "kappa": 1.0}
PARAMETERS = SCALING | {"length": 0.8, "q_rate": 1e-3, "r_angle": 4e-4}


def pendulum_log(
    name: str = "swing",
    *,
    seed: int = 0,
    duration: float = 20.0,
    start: tuple[float, float] = (0.7, 0.0),
    length: float = 0.8,
) -> Log:
    """Simulate a pendulum with random accelerations; its angle is measured at 10 Hz, between steps of the filter."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * 100) + 1) / 100
    p = PENDULUM.record(length, 1e-3, 4e-4)
    states = [np.array(start)]
    for dt in np.diff(time):
        nudge = np.array([0.0, np.sqrt(p.q_rate * dt) * rng.standard_normal()])
        states.append(swing(states[-1], dt, None, p) + nudge)
    true = np.array(states)
    moments = np.arange(0.053, duration, 0.1)
    seen = np.interp(moments, time, true[:, 0]) + 0.02 * rng.standard_normal(len(moments))
    return Log(
        name,
        time,
        moments,
        (seen + np.pi) % (2 * np.pi) - np.pi,
        mean=[start[0] + 0.05, start[1] - 0.1],
        covariance=np.diag([0.01, 0.04]),
        truth={"angle": true[:, 0], "rate": true[:, 1]},
    )


def point_model(**changes) -> Model:
    """Model of a point on a line: white-noise acceleration, measured position. Linear, so a Kalman filter is exact."""

    def f(state, dt, u, p):
        return np.array([state[0] + state[1] * dt, state[1]])

    def process_noise(dt, p):
        return p.q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])

    parts = {
        "name": "point",
        "states": ("place", "speed"),
        "f": f,
        "h": angle,
        "parameters": (Tunable("q", 1e-4, 1e2), Tunable("r", 1e-4, 1e2)),
        "process_noise": process_noise,
        "measurement_noise": lambda p: (p.r,),
    }
    return Model(**(parts | changes))


def point_log(name: str = "line", *, seed: int = 0, n: int = 600, q: float = 0.5, r: float = 0.3) -> Log:
    """Simulate the point model with jittered steps and a measurement at every second step."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 0.15, n))
    state, seen = np.array([1.0, -0.5]), []
    for i, dt in enumerate(np.diff(time, prepend=time[0])):
        q_step = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        push = np.linalg.cholesky(q_step) @ rng.standard_normal(2) if i else np.zeros(2)
        state = np.array([state[0] + state[1] * dt, state[1]]) + push
        seen.append(state[0] + np.sqrt(r) * rng.standard_normal())
    return Log(name, time, time[::2], np.array(seen[::2]), mean=[1.0, -0.5], covariance=np.eye(2) * 1e-6)
