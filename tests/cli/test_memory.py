"""What a command gives back to the system."""

import subprocess
import sys

import pytest

LEFT = """
import sys
from sigmaswarm.cli.memory import give_back_at_once
import numpy as np
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6
if sys.argv[1] == "back":
    give_back_at_once()
first = np.ones(2_000_000)
del first
before, blocks, between = resident(), [], []
for _ in range(10):
    blocks.append(np.ones(1_900_000))
    between.append(np.ones(50_000))  # what lies behind a block keeps its place in a heap
del blocks
print(resident() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc")
def test_large_blocks_go_back_at_once():
    def left(how: str) -> float:
        ended = subprocess.run([sys.executable, "-c", LEFT, how], capture_output=True, text=True, check=True)
        return float(ended.stdout)

    assert left("back") < 20  # MB, of which what lies between is 4
    if left("kept") < 50:
        pytest.skip("this C library gives them back by itself")
