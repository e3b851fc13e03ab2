"""Recordings: measured experiments, their files, their checks and their splits."""

from jaxsr.recordings.agreement import check_time_units
from jaxsr.recordings.checks import check_recording
from jaxsr.recordings.data_check import DataCheck
from jaxsr.recordings.noise import noise_level, quantisation_step
from jaxsr.recordings.reading import read_recording
from jaxsr.recordings.recording import Recording
from jaxsr.recordings.roles import rename
from jaxsr.recordings.splits import Block, blocks, folds
from jaxsr.recordings.time_units import as_written
from jaxsr.recordings.wrapping import unwrap
from jaxsr.recordings.writing import write_csv

__all__ = [
    "Block",
    "DataCheck",
    "Recording",
    "as_written",
    "blocks",
    "check_recording",
    "check_time_units",
    "folds",
    "noise_level",
    "quantisation_step",
    "read_recording",
    "rename",
    "unwrap",
    "write_csv",
]
