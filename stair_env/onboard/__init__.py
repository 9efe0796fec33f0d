"""What runs on the robot: attitude, leg odometry, the map of edges ahead and the gait."""
