"""A page in the browser in which a controller is shaped by hand: `tarc studio`."""

from tarc.core.optional import require

require("studio", "tarc.studio")
