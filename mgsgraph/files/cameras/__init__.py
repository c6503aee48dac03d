"""Line-scan cameras of the field: what their labels say, their constants, line times and distortion."""
