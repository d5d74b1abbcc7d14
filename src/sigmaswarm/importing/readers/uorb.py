"""PX4's messages (PX4-Autopilot, msg/), as its flight logs and its ROS 2 bags hold them.

Times in us since start; sensor_combined in the body's forward, right, down (m/s2, rad/s); fixes in degrees (or 1e-7
degrees, mm in older logs), velocity north and east.
"""

from collections.abc import Collection

from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.source import Part, Table

T = "timestamp*1e-6"
IMU = {
    **{"ax": "accelerometer_m_s2[0]", "ay": "-accelerometer_m_s2[1]", "az": "-accelerometer_m_s2[2]"},
    **{"gx": "gyro_rad[0]", "gy": "-gyro_rad[1]", "gz": "-gyro_rad[2]"},
}
TURNED = "PX4's axes turned from forward, right, down"


def fix(columns: Collection[str]) -> dict[str, str]:
    """Degrees and metres, of logs since PX4 1.14 and before; missing columns are omitted."""
    if "latitude_deg" in columns:
        place = {"lat": "latitude_deg", "lon": "longitude_deg", "alt": "altitude_ellipsoid_m"}
    else:
        place = {"lat": "lat*1e-7", "lon": "lon*1e-7", "alt": "alt_ellipsoid*1e-3"}
    accuracy = {"std_x": "eph/sqrt(2)", "std_y": "eph/sqrt(2)"}
    every = {**place, **accuracy, "vx": "vel_e_m_s", "vy": "vel_n_m_s", "keep": "fix_type >= 3"}
    return {name: text for name, text in every.items() if _there(text, columns)}


def _there(text: str, columns: Collection[str]) -> bool:
    return compile_expression(text, (*columns, *_NAMES)).columns <= set(columns)


_NAMES = (
    "altitude_ellipsoid_m",
    "alt_ellipsoid",
    "lat",
    "lon",
    "eph",
    "vel_e_m_s",
    "vel_n_m_s",
    "fix_type",
    "longitude_deg",
)


def part_of(topic: str, table: Table, role: str) -> Part | None:
    """The part of a role that a topic of px4_msgs gives; None where it gives none."""
    kind, columns = table.kind.rpartition("/")[2], table.columns
    if not table.kind.startswith("px4_msgs/"):
        return None
    if role == "imu" and kind == "SensorCombined":
        return Part(topic, {"t": T, **IMU})
    if (
        role == "gps"
        and kind in ("SensorGps", "VehicleGpsPosition")
        and {"lat", "lon"} <= fix(columns).keys()
    ):
        return Part(topic, {"t": T, **fix(columns)})
    return None
