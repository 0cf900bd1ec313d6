"""Files that are written completely or not at all, and texts that people edit, such as yaml files."""

from __future__ import annotations

import codecs
import contextlib
import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from common.config import WrittenMapping
from common.errors import ConfigError, RigError

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}", re.ASCII)


def user_file(kind: str, name: str) -> Path:
    """Returns the path of NAME.yaml in ~/.config/leap_rig/KINDs; raises RigError if the name is not one of a file."""
    if not FILE_NAME.fullmatch(name):
        allowed = "must be up to 100 letters, digits, - and _, and begin with a letter or digit"
        raise RigError(f"The name of the {kind.replace('_', ' ')} is {name!r}, but {allowed}.")
    return home() / ".config" / "leap_rig" / f"{kind}s" / f"{name}.yaml"


def read_text(path: Path) -> str:
    """Returns the text of a file as `text_of` does; raises OSError too."""
    return text_of(path.read_bytes())


def text_of(content: bytes) -> str:
    """Returns the text of a file's content, in UTF-8 or as Windows writes it: with a byte order mark, in UTF-16, with
    its line ends; blanks at the end of a line are left out. Raises ValueError if it is no text."""
    utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = content.decode("utf-16" if utf16 else "utf-8-sig")
    return "\n".join(line.rstrip(" \t") for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))


def home() -> Path:
    """Returns the user's home; raises RigError if there is none, as in a container for a user without a name."""
    try:
        return Path.home()
    except RuntimeError as error:
        raise RigError("HOME is not set, and this user has no home: set HOME, and ROS_HOME if not below it.") from error


class _Loader(yaml.SafeLoader):
    """Mappings keep how texts were written; keys and dates are texts. A key that stands twice is an error: what is
    under the first would be lost."""

    def written(self, node: yaml.MappingNode) -> Iterator[WrittenMapping]:
        """Constructs a mapping, as `SafeLoader.construct_yaml_map` does: first empty, for what refers to it."""
        keys = [key.value for key, _ in node.value]
        twice = next((key for i, key in enumerate(keys) if key in keys[:i]), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(None, None, f"the key {twice!r} stands twice", node.start_mark)
        self.flatten_mapping(node)
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                key.tag = yaml.resolver.Resolver.DEFAULT_SCALAR_TAG
        texts = ((key.value, _text(value)) for key, value in node.value)
        mapping = WrittenMapping({}, {key: text for key, text in texts if text is not None})
        yield mapping
        mapping.update(self.construct_mapping(node))

    yaml_constructors = {  # noqa: RUF012
        **yaml.SafeLoader.yaml_constructors,
        yaml.resolver.Resolver.DEFAULT_MAPPING_TAG: written,
        "tag:yaml.org,2002:timestamp": yaml.SafeLoader.construct_yaml_str,
        "tag:yaml.org,2002:value": yaml.SafeLoader.construct_yaml_str,  # =
    }


def _text(node: yaml.Node) -> str | list[str] | None:
    """Returns the text of a scalar, or those of a list of scalars; None for another node."""
    if isinstance(node, yaml.ScalarNode):
        return node.value
    texts = [one.value for one in node.value] if isinstance(node, yaml.SequenceNode) else [None]
    return texts if all(isinstance(text, str) for text in texts) else None


def read_yaml(path: Path) -> Any:
    """Returns what a yaml file holds; raises ConfigError if it cannot be read, or is not yaml."""
    try:
        return yaml.load(read_text(path), Loader=_Loader)
    except OSError as error:
        raise ConfigError([f"{path} cannot be read: {error.strerror}."]) from error
    except Exception as error:  # the library's constructors raise anything: ValueError for 0x_
        raise ConfigError([f"{path} is not yaml: {' '.join(str(error).split())}."]) from error


def file_hash(path: str) -> str:
    """Returns the SHA-256 of a file, or a sentence if it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        return f"{path} cannot be read: {error.strerror}"


def write_whole(path: Path, content: str | bytes) -> None:
    """Replaces a file, a text in UTF-8, and makes its folder; raises OSError if that fails, such as on a full disk: the
    file stays as it is. A killed process leaves a file named by a dot, the file's name, and eight characters."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}", dir=str(path.parent))
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content.encode("utf-8") if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
