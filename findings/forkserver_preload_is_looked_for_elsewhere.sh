#!/usr/bin/env bash
# Python 3.11.7, multiprocessing: the server of forks gets its parent's sys.path and does not use it to find what it is to preload.
#
# Guess before the run: a module beside the script, named in set_forkserver_preload, is imported once by the server, wherever the
# script is started from; what cannot be found is an error.
# Seen: that holds only where the script is started in its own folder. From any other one every child imports the module anew, and
# nothing says so: the server passes over an ImportError. For a module that takes seconds the server is then slower than spawning.
set -eu
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
mkdir "$work/own" "$work/other"
cat > "$work/own/heavy.py" <<'PY'
import os

IMPORTED_BY = os.getpid()


def tell():
    print("by the child" if os.getpid() == IMPORTED_BY else "by the server", flush=True)
PY
cat > "$work/own/run.py" <<'PY'
import multiprocessing

import heavy

if __name__ == "__main__":
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["heavy"])
    child = context.Process(target=heavy.tell)
    child.start()
    child.join()
PY
python=$(command -v python3.11 || command -v python3)
"$python" -c 'import sys; print("Python", ".".join(map(str, sys.version_info[:3])))'
own=$(cd "$work/own" && "$python" run.py)
other=$(cd "$work/other" && "$python" "$work/own/run.py")
echo "started in its own folder: imported $own - in another one: imported $other"
[ "$own" = "by the server" ] && [ "$other" = "by the child" ]
# Output: started in its own folder: imported by the server - in another one: imported by the child
