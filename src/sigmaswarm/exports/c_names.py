"""Names in C of the states, and of the parameters and elements that a kernel reads."""

from sigmaswarm.drives import timeline

STATES = (
    "X", "Y", "VX", "VY", "HEADING", "ACCEL_X", "ACCEL_Y", "GYRO", "ROLL", "PITCH", "GYRO_X", "GYRO_Y",
    "FIX_ERROR_X", "FIX_ERROR_Y",
)  # fmt: skip
"""Names of the states in C, in the order of the largest model."""
FIX_ERROR = STATES[-2:]
PARAMETERS = {
    "w": ("InsGpsEstimate *b", "Work *work"),
    "u": ("real dt", "real steps", "const InsGpsSample *sample"),
    "z": ("const InsGpsFix *fix",),
    "lever": ("const real *lever",),
    "wheels": ("const Wheels *wheels",),
    "events": ("unsigned events",),
    "since": ("InsGpsEstimate *b",),
    "l": (),
}
"""C parameters that replace a parameter of a kernel. A C function has only the parameters that it uses."""
WHEELS = ("speed", "age", "more")
"""Fields of an odometer measurement, in the order of `drives.odometer`."""
_AXES = ["yaw_rate" if axis == "gz" else axis for axis in timeline.AXES]
INPUTS = {
    "u": {
        timeline.DT: "dt",
        timeline.Q_SCALE: "steps",
        timeline.GAP: "sample->gap",
        **{k: f"sample->{axis}" for k, axis in enumerate(_AXES, timeline.FIRST_AXIS)},
    },
    "z": {
        timeline.FIX_X: "(fix->x - b->origin[0])",
        timeline.FIX_Y: "(fix->y - b->origin[1])",
        timeline.FIX_VX: "fix->vx",
        timeline.FIX_VY: "fix->vy",
        timeline.FIX_VAR_X: "fix->variance[0]",
        timeline.FIX_VAR_Y: "fix->variance[1]",
        timeline.FIX_THETA: "fix->heading",
        timeline.FIX_VAR_THETA: "fix->heading_variance",
    },
    "wheels": {k: f"wheels->{name}" for k, name in enumerate(WHEELS)},
    "lever": {k: f"lever[{k}]" for k in range(3)},
}
"""C text of the elements of a step, a fix, an odometer measurement and the lever arm."""
_FUNCTIONS = ("SIN", "COS", "SQRT", "HYPOT", "EXP", "LOG", "FLOOR")
CALLS = {
    **{f"{module}.{name.lower()}": name for module in ("np", "math") for name in _FUNCTIONS},
    "abs": "FABS",
    "angle_of": "ATAN2",
    "np.arctan2": "ATAN2",
}
RENAMED = {"_": "again", "b": "b0", "since": "b->steps_since_fix", "near": "is_near", "far": "is_far"}
"""C names of Python names that are reserved or stored elsewhere in C."""
