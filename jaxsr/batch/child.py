"""The process of one case: the command, under a limit of memory, ended when its parent dies.

``python -m jaxsr.batch.child PARENT MEMORY MARK KEY diagnose ...``, with the parent's process id,
the memory in bytes, 0 for no limit, and a file that says, by its key, that the case is done. The
process writes it itself: its parent may be killed when the results are there.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from pathlib import Path

from jaxsr._process import listen

_LOOK = 0.5  # seconds between looks at the parent


def main() -> int:
    """Run the command and return its exit status."""
    parent, memory = int(sys.argv[1]), int(sys.argv[2])
    mark, key = sys.argv[3:5]
    _limit(memory)
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    sys.argv = ["jaxsr", *sys.argv[5:]]
    listen()  # before the imports, which take seconds on a busy machine
    from jaxsr._files import atomic_write_text
    from jaxsr.cli import main as run

    status = run()
    if status == 0:
        atomic_write_text(Path(mark), key + "\n")
    return status


def _follow(parent: int) -> None:
    """End this process when its parent is gone: whoever comes after starts the case again."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)


def _limit(memory: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    if memory:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


if __name__ == "__main__":
    sys.exit(main())
