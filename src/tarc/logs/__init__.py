"""Recorded motion of real robots held against estimators, models, laws and designs."""

from tarc.core.optional import require

require("cli", "tarc.replay")
