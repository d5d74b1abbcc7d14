"""What more cores are worth, by the model that a batch is shared out by: `python benchmarks/sharing.py`.

For more processors than there are at hand: `scoring.jobs` says what a generation takes of so many workers. What one
thread does before and after it (parameters of points, costs) is added; `benchmarks/test_cores.py` measures two.
"""

from sigmaswarm.scoring.jobs import jobs_for, makespan

ALONE = 0.5e-3
"""s of a generation of 30 in which only one thread works."""
KITTI = 8_300, 9_700, 12_700, 16_600, 28_800
TEN_MINUTES = (60_000,) * 5
WORKERS = 1, 2, 4, 8, 16


def main() -> None:
    print("| 30 sets | " + " | ".join(f"{n} cores" for n in WORKERS) + " |")
    print("|---|" + "---:|" * len(WORKERS))
    for label, model, steps in (
        ("planar5, KITTI's five drives", "planar5", {"tracking": KITTI}),
        ("planar5, five drives of ten minutes", "planar5", {"tracking": TEN_MINUTES}),
        ("planar8, KITTI's five, with outages", "planar8", {"tracking": KITTI, "outages": KITTI}),
        ("tilted12, KITTI's five, with outages", "tilted12", {"tracking": KITTI, "outages": KITTI}),
        ("tilted12, five of ten minutes, with outages", "tilted12", {"tracking": TEN_MINUTES, "outages": TEN_MINUTES}),
    ):  # fmt: skip
        taken = [ALONE + makespan(jobs_for(steps, 30, model, n), n) for n in WORKERS]
        print(f"| {label} | " + " | ".join(f"{taken[0] / each:.2f}" for each in taken) + " |")


if __name__ == "__main__":
    main()
