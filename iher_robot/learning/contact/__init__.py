"""Contact-first exploration: a second policy that brings the effector to the object."""
