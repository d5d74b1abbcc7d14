"""A stand-in for a CARLA server, in a process of its own: the genuine client's protocol, sigmaswarm's car.

`wire` speaks msgpack-RPC and streams, `town` writes an OpenDRIVE map, `car` drives, `world` answers the client's
calls, `server` is the process with its faults on demand and its watchdog.
"""
