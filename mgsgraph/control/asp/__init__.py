"""Files of the Ames Stereo Pipeline: matches, ground control points, NVM."""
