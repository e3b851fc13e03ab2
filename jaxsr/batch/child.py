"""The process of one case: the command, under a limit of memory, ended when its parent dies.

``python -m jaxsr.batch.child PARENT MEMORY diagnose ...``, with the parent's process id and the
memory in bytes, 0 for no limit.
"""

from __future__ import annotations

import os
import sys
import threading
import time

_LOOK = 0.5  # seconds between looks at the parent


def main() -> int:
    """Run the command and return its exit status."""
    parent, memory = int(sys.argv[1]), int(sys.argv[2])
    _limit(memory)
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    sys.argv = ["jaxsr", *sys.argv[3:]]
    from jaxsr.__main__ import main as run

    return run()


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
