"""A stand-in for a CARLA server in a separate process, with the protocol of the genuine client and sigmaswarm's car.

`wire` implements msgpack-RPC and streams, `town` writes an OpenDRIVE map, `car` simulates the car, `world` answers the
client's calls, and `server` is the process, with faults on demand and a watchdog.
"""
