"""Pictures, films and pages of recorded episodes and of floor plans."""
