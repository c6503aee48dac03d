"""Solutions as other programs take them: SPICE kernels, CSM support data, ISIS, ASP, GIS; and read back to be sure."""
