"""The parameters of the cockpit."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, flag, integer, path, text
from leap_motion.service.access import origin_faults
from vision.stereo.transport import AUTO, JPEG, WEBRTC


@dataclass(frozen=True)
class CockpitConfig:
    """Private parameters of the node cockpit."""

    page: str = path(doc="file of the page; empty: that of the package", absent="")
    host: str = text(doc="address to serve on; 0.0.0.0: the whole network", absent="127.0.0.1")
    port: int = integer(low=0, high=65535, doc="port; 0: any free one", absent=8470)
    name: str = text(doc="further name of this computer that the page may be asked for by", absent="", empty=True)
    public: str = text(doc="origin under which a relay or proxy shows the page; empty: none", absent="", empty=True)
    arms: str = text(doc="namespaces of several arms, with spaces between them; empty: one arm", absent="", empty=True)
    cameras: str = text(doc="cameras, as namespaces of their topics, with spaces between them", absent="camera")
    video: str = choice(AUTO, JPEG, WEBRTC, doc="how images go; auto: jpeg to this machine, else webrtc", absent=AUTO)
    only_view: bool = flag(doc="who enables here sees the arm only here; old images release that", absent=False)

    def faults(self) -> list[str]:
        return origin_faults(self.public)
