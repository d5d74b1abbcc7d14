"""Users' models: any system with states, a process f and a measurement h."""
