"""Training runs: collect on the robot, learn, evaluate, resume."""
