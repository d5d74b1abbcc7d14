"""Record the paper's drives from a CARLA server, as folders that sigmaswarm reads.

    python -m sigmaswarm_carla --out drives --maneuver brake turns --environment clear rain --runs 5

A Tesla Model 3 drives in synchronous mode at 100 Hz, with an IMU at 100 Hz and GNSS at 5 Hz. The truth comes from the
snapshots of CARLA's world. The package needs Python 3.8 or later and the `carla` client of the server's version.
``python -m sigmaswarm_carla.pack carla_recorder.pyz`` writes the package to one file, for machines with an old CARLA.
"""
