"""The host of a robot: what runs beside the robot and trusts no client."""
