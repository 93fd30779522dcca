"""The study of hidden effects: arms, motions, friction and effects made without the package, and what is counted."""
