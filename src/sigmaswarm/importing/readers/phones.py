"""Constants of phones' logs: the assumed mounting, and the divisor that makes an accuracy a standard deviation."""

# A phone's x points right and y to its top edge (Android's SensorEvent), so forward is y and left is -x
FLAT_NOTE = (
    "the phone is assumed to lie flat with the screen up and the top edge forward; otherwise add --mount, or "
    "--mount auto"
)

# Radius of a circle that contains 68.27% of normal errors, in standard deviations per axis: sqrt(-2 ln 0.3173)
RADIUS_68 = 1.515
