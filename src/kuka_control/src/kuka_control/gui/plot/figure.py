"""The whole picture: the scene in space on the left; on the right the constrained samples above, the reach below."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from kuka_control.gui.plot import colours
from kuka_control.gui.plot.picture import WorkspacePicture
from kuka_control.gui.plot.scene import draw_scene
from kuka_control.gui.plot.views import draw_reach, draw_samples

SIZE_INCH = (18.0, 10.0)
TEXT_PT = 10.5
HEADING = {"fontsize": 13, "fontweight": "bold", "va": "center"}


def draw(figure: Figure, picture: WorkspacePicture) -> None:
    """Draws the picture on an empty figure of `SIZE_INCH`."""
    figure.text(0.02, 0.965, picture.title, fontsize=15, fontweight="bold", va="center")
    draw_scene(figure.add_axes((0.012, 0.16, 0.43, 0.76), projection="3d", computed_zorder=False), picture)
    figure.legend(handles=_scene_legend(), loc="upper left", bbox_to_anchor=(0.012, 0.94), ncol=5,
                  fontsize=TEXT_PT - 1, frameon=False, handlelength=1.4)  # fmt: skip
    figure.text(0.02, 0.155, "\n".join(picture.notes), fontsize=TEXT_PT, va="top", linespacing=1.55)

    left, right, width, height = 0.475, 0.725, 0.215, 0.35
    figure.text(left, 0.965, "How positions are constrained", **HEADING)
    above = figure.add_axes((left, 0.58, width, height)), figure.add_axes((right, 0.58, width, height))
    draw_samples(*above, picture)
    figure.legend(handles=_sample_legend(picture), loc="upper left", bbox_to_anchor=(left - 0.008, 0.54), ncol=4,
                  fontsize=TEXT_PT - 1, frameon=False, columnspacing=1.4, handletextpad=0.3)  # fmt: skip

    figure.text(left, 0.461, "Where the arm reaches", **HEADING)
    below = figure.add_axes((left, 0.065, width, height)), figure.add_axes((right, 0.065, width, height))
    fractions = draw_reach(*below, picture)
    bar = figure.colorbar(fractions, cax=figure.add_axes((0.95, 0.065, 0.009, height)))
    bar.set_label("orientations within the tolerances that are reached [%]", fontsize=TEXT_PT - 1)
    figure.legend(handles=_reach_legend(picture), loc="center right", bbox_to_anchor=(0.948, 0.461), ncol=2,
                  fontsize=TEXT_PT - 1, frameon=False, handletextpad=0.3)  # fmt: skip


def _scene_legend() -> list[Line2D]:
    arm = Line2D([], [], color=colours.ARM, linewidth=6, solid_capstyle="round", label="arm at home")
    border = Line2D([], [], color=colours.WORKSPACE, linewidth=2, label="workspace")
    axes = (
        Line2D([], [], color=colour, linewidth=3, label=f"{name} axis") for name, colour in zip("xyz", colours.AXES)
    )
    return [arm, border, *axes]


def _sample_legend(picture: WorkspacePicture) -> list[Line2D]:
    counts = {acted: int(picture.samples.group(acted).sum()) for acted in colours.ACTED}
    return [_dots(colour, "o", f"{acted} ({counts[acted]})") for acted, colour in colours.ACTED.items()]


def _reach_legend(picture: WorkspacePicture) -> list[Line2D]:
    return [
        _dots(colours.UNREACHED, "x", f"out of reach with the tool straight down ({len(picture.unreached)})"),
        _dots("black", "*", "workspace centre", 11),
    ]


def _dots(colour: str, marker: str, label: str, size: float = 7) -> Line2D:
    return Line2D([], [], linestyle="none", marker=marker, markersize=size, color=colour, label=label)
