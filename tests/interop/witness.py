"""Witness of the machine's stalls: it does what a MainDevice and a served segment need of the machine, and nothing else.

On each processor a process with a priority above theirs wakes every 2 ms and sends itself a datagram over the loopback interface, which
takes the kernel's way of a veth pair. When it is late, the machine was: its host gave no time, or the kernel held up a thread
that nothing else may hold up, or packets lay about. A MainDevice or a service that spins or blocks can't make it late.
"""
import os
import shutil
import socket
import subprocess
import sys
import time

PERIOD = 0.002
# Below this nothing here fails.
LEAST = 0.001
PRIORITY = 60


class Witness:
    """Watches from `with` on. `stalls` gives what it saw so far: pairs of begin and length in seconds, on the monotonic clock."""

    def __init__(self, folder):
        self.files = [folder / f"stalls-{cpu}.txt" for cpu in sorted(os.sched_getaffinity(0))]

    def __enter__(self):
        first = ["chrt", "--fifo", str(PRIORITY)] if shutil.which("chrt") else []
        self.processes = []
        for cpu, file in zip(sorted(os.sched_getaffinity(0)), self.files):
            command = [*first, sys.executable, __file__, str(cpu), str(file)]
            self.processes.append(subprocess.Popen(command))
        return self

    def __exit__(self, *_):
        for process in self.processes:
            process.terminate()
            process.wait()

    def stalls(self):
        for process in self.processes:
            if process.poll() is not None:
                raise RuntimeError(f"the witness of stalls ended with {process.returncode}")
        lines = [line.split() for file in self.files if file.exists() for line in file.read_text().splitlines()]
        return sorted((float(line[0]), float(line[1])) for line in lines if len(line) == 2)


def watch(cpu, file):
    os.sched_setaffinity(0, {cpu})
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.bind(("127.0.0.1", 0))
    wire.connect(wire.getsockname())
    wire.settimeout(10)
    with open(file, "w", buffering=1) as lines:
        due = time.monotonic() + PERIOD
        while True:
            time.sleep(max(0.0, due - time.monotonic()))
            wire.send(b"x")
            wire.recv(1)
            now = time.monotonic()
            if now - due > LEAST:
                lines.write(f"{due:.6f} {now - due:.6f}\n")
            due = max(due + PERIOD, now)


if __name__ == "__main__":
    watch(int(sys.argv[1]), sys.argv[2])
