"""The processes of a fleet, one a robot, with a maximum number at a time.

A dead process costs one robot; the others go on. The first SIGINT or SIGTERM stops all in order, the second kills.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType

from hickory_stream.fleet import robot_process
from hickory_stream.fleet.messages import Ended, Message
from hickory_stream.fleet.robot_process import RobotTask

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run_crew(
    tasks: Sequence[RobotTask],
    processes: int,
    hear: Callable[[str, Message], None],
    main: Callable[[RobotTask, Connection], None] = robot_process.main,
) -> dict[str, Ended]:
    """Map all robots in the order of `tasks`, `processes` at a time; return the end of each.

    `hear` gets the messages of a robot by name, last its `Ended`. `main` is the function of a process, and calls
    `robot_process.listen`. A second signal raises `KeyboardInterrupt`.
    """
    crew = _Crew(tasks, processes, hear, main)
    with _Signals(crew):
        try:
            return crew.run()
        finally:
            crew.kill()


class _Crew:
    def __init__(
        self,
        tasks: Sequence[RobotTask],
        processes: int,
        hear: Callable[[str, Message], None],
        main: Callable[[RobotTask, Connection], None],
    ) -> None:
        self._waiting = list(tasks)
        self._processes = processes
        self._hear = hear
        self._main = main
        self._running: dict[Connection, tuple[RobotTask, SpawnProcess]] = {}
        self._ended: dict[str, Ended] = {}
        self._is_stopping = False
        self._signalled: set[str] = set()

    def run(self) -> dict[str, Ended]:
        while self._waiting or self._running:
            while self._waiting and len(self._running) < self._processes:
                self._begin(self._waiting.pop(0))
            # After a signal, those that waited end without a process: to wait for none would never end.
            for connection in wait(list(self._running)) if self._running else ():
                self._listen(connection)  # type: ignore[arg-type]
        return self._ended

    def stop(self) -> None:
        self._is_stopping = True
        for _, process in list(self._running.values()):
            # A second signal would cancel a robot that saves its map.
            if process.name not in self._signalled and process.pid is not None and process.is_alive():
                self._signalled.add(process.name)
                os.kill(process.pid, signal.SIGINT)

    def kill(self) -> None:
        for connection, (_, process) in self._running.items():
            process.kill()
            process.join()
            connection.close()
        self._running.clear()

    def _begin(self, task: RobotTask) -> None:
        if self._is_stopping:
            self._end(task.robot.name, Ended(is_finished=False, was_stopped=True, reason="stopped before it began"))
            return
        # Forking would copy the threads' locks as they are.
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=self._main, args=(task, theirs), name=f"robot-{task.robot.name}")
        with _signals_held():
            process.start()
            theirs.close()  # ours ends when the process does
            self._running[ours] = (task, process)
        if self._is_stopping:
            self.stop()  # the signal came while it was not among those that run

    def _listen(self, connection: Connection) -> None:
        task, process = self._running[connection]
        try:
            message = connection.recv()
        except (EOFError, OSError):
            message = None
        if message is not None and not isinstance(message, Ended):
            self._hear(task.robot.name, message)
            return
        process.join()
        connection.close()
        del self._running[connection]
        self._end(task.robot.name, message or Ended(is_finished=False, reason=_death(process.exitcode)))

    def _end(self, name: str, ended: Ended) -> None:
        self._ended[name] = ended
        self._hear(name, ended)


def _death(status: int | None) -> str:
    if status is not None and status < 0:
        known = {number.value: number.name for number in signal.Signals}
        return f"its process was killed by {known.get(-status, f'signal {-status}')}"
    return f"its process ended with status {status} and without a word"


@contextmanager
def _signals_held() -> Iterator[None]:
    # A process that starts here inherits the mask, and gets a signal when it listens.
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its own start would end the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Signals:
    # While entered, the first signal stops a crew, the second raises `KeyboardInterrupt`.
    def __init__(self, crew: _Crew) -> None:
        self._crew = crew
        self._count = 0
        self._before: dict[int, object] = {}

    def __enter__(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                self._before[number] = signal.signal(number, self._handle)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._count += 1
        if self._count > 1:
            raise KeyboardInterrupt
        self._crew.stop()
