"""Contact-first exploration: a second policy that brings the gripper to the object."""
