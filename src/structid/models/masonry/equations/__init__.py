"""The equations of motion of a wall and their solution."""
