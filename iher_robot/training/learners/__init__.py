"""Where the learner computes: in this process, beside the robot, or in several processes."""
