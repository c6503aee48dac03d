"""Control networks as files hold them: the whole record, ISIS's binary and PVL forms, and tables."""
