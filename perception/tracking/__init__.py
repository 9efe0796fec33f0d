"""From single estimates to one staircase that moves with the robot."""
