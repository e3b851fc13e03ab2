"""Live use: says when a machine stops following its model, at a stated rate of false alarms.

`following` linearises the model along windows of a stream and weighs filters on them, by the
state-space filter of the likelihood; `normal` calibrates what normal running looks like,
`alternatives` says what may be different, `detector` adds up the evidence; `live` joins them,
`folder` reads a folder that grows.
"""

from jaxsr.monitoring.alarm import Alarm
from jaxsr.monitoring.live import Monitor, monitor

__all__ = ["Alarm", "Monitor", "monitor"]
