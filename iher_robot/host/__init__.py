"""The host of a robot: runs the control loop beside the robot and trusts no client."""
