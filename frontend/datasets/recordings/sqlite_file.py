"""Files ``.db3`` of ROS 2 bags: a database of messages."""

from __future__ import annotations

import sqlite3

from .message_file import MessageFile, Place, Topic, unreadable


class SqliteFile(MessageFile):
    """A ``.db3`` file."""

    ros1 = False

    def topics(self) -> list[Topic]:
        """See :meth:`MessageFile.topics`."""
        with unreadable(self.path, "no bag that can be read"):
            rows = self._open().execute(
                "SELECT topics.id, name, type, COUNT(messages.id) FROM topics LEFT JOIN messages "
                "ON topics.id = messages.topic_id GROUP BY topics.id"
            )
            return [Topic(str(name), str(kind), int(count), (int(number),)) for number, name, kind, count in rows]

    def places(self, topic: Topic) -> list[tuple[int, Place]]:
        """See :meth:`MessageFile.places`."""
        with unreadable(self.path, f"the messages of {topic.name} cannot be listed"):
            rows = self._open().execute("SELECT timestamp, id FROM messages WHERE topic_id = ?", topic.ids)
            return [(int(time), Place(int(row))) for time, row in rows]

    def _open(self) -> sqlite3.Connection:
        journal = self.location.with_name(self.location.name + "-wal")
        if journal.exists() and journal.stat().st_size:
            raise ValueError(f"it was not closed: {journal.name} holds messages; open it once with `ros2 bag info`")
        uri = f"{self.location.resolve().as_uri()}?mode=ro&immutable=1"
        return sqlite3.connect(uri, uri=True, check_same_thread=False)

    def _message(self, place: Place, most: int) -> bytes:
        with self._handle.blobopen("messages", "data", place.start, readonly=True) as blob:  # not the rest of it
            data: bytes = blob.read(min(most, len(blob)))
        return data
