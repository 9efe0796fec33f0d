"""Policies of joint angles, without gait or clock: what they keep in mind, who teaches them, and left as right."""
