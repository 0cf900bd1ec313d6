"""Writes episodes from a thread of its own, each whole or not at all, and sets the last one aside on demand.

An episode that the disk does not take stays in memory and is tried again, until it is written or the node ends.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import rospy

from common import clock
from common.ros.files import write_whole
from grasping.lab.dataset.collector import SAME_GRASP_S
from grasping.lab.dataset.episode import Episode
from grasping.lab.dataset.store import SUFFIX, DatasetError, encode, file_name, grasp_time, unfinished

WAITING = 2  # episodes that may wait to be packed; each is up to half a megabyte a frame
WAITING_BYTES = 500_000_000  # most memory for packed episodes that the disk did not take
RETRY_S = 2.0  # time between two attempts
ASIDE = ".discarded"


class _Packed(NamedTuple):
    episode: Episode
    file: Path
    content: bytes


class EpisodeFiles:
    """The folder of the dataset, which is made with the first episode."""

    def __init__(self, folder: Path, on_written: Callable[[Episode, Path, int], None]) -> None:
        self._folder, self._on_written = folder, on_written
        self._queue: clock.Queue[Episode | None] = clock.Queue(maxsize=WAITING)
        self._last: Path | None = None
        self._aside = False
        self._lock = clock.Lock()
        self._packed: list[_Packed] = []
        self.lost = 0  # how many episodes will not be written
        self._loss = self._write_fault = ""
        for file in sorted(folder.glob(".*")):
            if unfinished(file.name):
                rospy.logwarn("The episode in %s is lost: the process that wrote it died. Delete the file.", file)
        self._thread = clock.Thread(target=self._loop, name="episodes", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        return len(self._packed)

    @property
    def fault(self) -> str:
        """What is wrong, as a sentence; empty if the last episode was written."""
        return " ".join(filter(None, (self._loss, self._write_fault)))

    def put(self, episode: Episode) -> None:
        """Hands an episode over; it is lost if the disk is too slow for those before it."""
        try:
            self._queue.put_nowait(episode)
        except clock.Full:
            self._lose(f"{WAITING} episodes before it are still being written.")

    def close(self) -> None:
        """Waits for what is still to be written, and says what the disk does not take even now."""
        flush_s = 6.0  # twice this time is less than the 15 s that roslaunch gives a node to exit
        with contextlib.suppress(clock.Full):
            self._queue.put(None, timeout=flush_s)
            self._thread.join(flush_s)
        if self._thread.is_alive():
            rospy.logerr("The episode that is being written is lost: the disk took longer than %g s.", flush_s)

    def keep_last(self, keep: bool) -> tuple[bool, str]:
        """Sets the file of the last episode aside, or takes it back; returns success and a sentence."""
        with self._lock:
            if self._last is None:
                return False, "No episode was written yet."
            aside = self._last.with_name(self._last.name + ASIDE)
            if keep == (not self._aside):
                return True, f"The episode {self._last} {'counts' if keep else 'is aside'} already."
            try:
                (aside if keep else self._last).rename(self._last if keep else aside)
            except OSError as error:
                return False, f"The episode {self._last} stays as it is: {error.strerror}."
            self._aside = not keep
            return True, f"The episode {self._last} {'counts again' if keep else f'is set aside as {aside.name}'}."

    def _loop(self) -> None:
        while True:
            try:
                episode = self._queue.get(timeout=RETRY_S if self._packed else None)
            except clock.Empty:
                self._write()
                continue
            if episode is not None:
                self._pack(episode)
            self._write()
            if episode is None:
                for packed in self._packed:
                    self._lose(f"{packed.file} could not be written until the end.")
                return

    def _pack(self, episode: Episode) -> None:
        there = self._same_grasp(episode.t_grasp)
        if there is not None:
            self._lose(f"{there} holds that grasp already.")
            return
        try:
            packed = _Packed(episode, self._folder / file_name(episode), encode(episode))
        except DatasetError as error:
            self._lose(str(error))
            return
        if sum(len(p.content) for p in (*self._packed, packed)) > WAITING_BYTES:
            self._lose(f"{self.waiting} episodes before it wait for the disk and fill the allowed memory. Make room.")
            return
        self._packed.append(packed)

    def _write(self) -> None:
        """Writes what waits, the oldest first, until the disk takes no more."""
        while self._packed:
            episode, file, content = self._packed[0]
            try:
                with self._lock:
                    write_whole(file, content)
                    self._last, self._aside = file, False
            except OSError as error:
                write_fault = f"An episode waits in memory: {file} cannot be written: {error.strerror}. Make room."
                if write_fault != self._write_fault:
                    rospy.logerr(write_fault)
                self._write_fault = write_fault
                return
            del self._packed[0]
            self._loss = self._write_fault = ""
            self._on_written(episode, file, len(content))

    def _same_grasp(self, t_grasp: float) -> Path | None:
        """Returns the file of that grasp, as where a recording is played again; it may be set aside."""
        for file in self._folder.glob(f"*{SUFFIX}*"):
            time = grasp_time(file.name[: -len(ASIDE)] if file.name.endswith(ASIDE) else file.name)
            if time is not None and abs(time - t_grasp) < SAME_GRASP_S:
                return file
        times = ((packed.file, packed.episode.t_grasp) for packed in self._packed)
        return next((file for file, time in times if abs(time - t_grasp) < SAME_GRASP_S), None)

    def _lose(self, why: str) -> None:
        self._loss = f"An episode is lost: {why}"
        self.lost += 1  # last: who sees the count also sees why
        rospy.logerr(self._loss)
