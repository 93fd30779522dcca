"""The camera's study (section 4.2.3): a simulated camera, what it makes of a joint's stiffness, and figures of that."""
