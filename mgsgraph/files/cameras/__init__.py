"""Line-scan cameras of the field, one file each: what their labels say, their constants, line times and distortion.

A new camera is one file with a `Camera` record in it and its line in `table.CAMERAS`. Both roads take it from there:
that of cubes with their own SPICE tables (`labels.isis_cube`) and that of kernels (`labels.labelled_image`).
"""
