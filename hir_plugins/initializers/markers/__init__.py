"""Scale and level of a capture from printed markers (ArUco, AprilTag)."""
