"""What a command took for a long drive goes back to the system as soon as it is done with."""

import ctypes
import gc
import sys

LARGE = 4 << 20
"""Bytes of a block that is given back at once. A column of ten hours at 100 Hz has 29 million."""
_M_MMAP_THRESHOLD = -3
"""Of glibc's malloc.h."""


def give_back_at_once() -> None:
    """Have glibc keep large blocks in pages of their own, which go back to the system when they are freed.

    By itself it takes blocks of up to 32 MB from a heap, once such a block has been freed; so the columns of a day's
    drive left holes, and a command held half a gigabyte more than it had use for. Elsewhere this does nothing.
    """
    if sys.platform != "linux":
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return
    mallopt(_M_MMAP_THRESHOLD, LARGE)


def look_seldom_for_cycles() -> None:
    """Have Python look for unreachable cycles a hundredth as often as by itself.

    The 160 000 objects of libraries, which stay, would be looked through again and again while they are made, for
    a tenth of a command's time; what a drive's numbers take is not freed by that, but when it is done with.
    """
    gc.set_threshold(50_000, 20, 20)
