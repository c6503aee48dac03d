"""Control networks as files hold them: the whole record, ISIS's binary and PVL forms, tables, and files of the Ames
Stereo Pipeline.
"""
