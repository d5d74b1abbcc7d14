"""The driving swarm: filters of one tuning, differently tuned, whose mixture drives; it moves while the car does."""
