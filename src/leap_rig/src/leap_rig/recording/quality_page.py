"""The page of a dataset: what is refused, how episodes differ, and films of the worst; a file of its own."""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from leap_rig.recording.quality import GRID_S, MEASURES, EpisodeQuality, QualityFault, spread_of_starts

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:75em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;font-size:13px}td,th{padding:.2em .6em;border-bottom:1px solid #ddd;text-align:right}
th{font-weight:600;vertical-align:bottom}td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}
.bad{color:#b00020}.far{background:#ffe9b0}.fit{color:#1b6e2e}
figure{display:inline-block;margin:0 1em 1em 0;max-width:262px;vertical-align:top}
figcaption{font-size:13px}svg{background:#fafafa;border:1px solid #ddd}
.film img,.film input{display:block;width:260px;margin:0}
"""
FILMS = """
for (const film of document.querySelectorAll(".film")) {
  const [image, slider] = film.querySelectorAll("img, input"), images = JSON.parse(film.querySelector("script").text);
  let plays = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  const show = i => { slider.value = i; image.src = "data:image/jpeg;base64," + images[i]; };
  slider.oninput = () => { plays = false; show(+slider.value); };
  image.onclick = () => { plays = !plays; };
  setInterval(() => { if (plays) show((+slider.value + 1) % images.length); }, +film.dataset.every);
}
"""
TIMES = 2.0  # as fast as it was
BAD, FAIR = "#b00020", "#2a6fbb"
WIDTH, HEIGHT, EDGE = 260, 110, 8


def worst_first(episodes: Sequence[EpisodeQuality]) -> list[int]:
    """Returns the indices of the episodes, those with most faults and outliers first."""
    return sorted(range(len(episodes)), key=lambda i: (-len(episodes[i].faults), -len(episodes[i].outliers)))


def page(
    episodes: Sequence[EpisodeQuality],
    faults: Sequence[QualityFault],
    remarks: Sequence[str],
    films: Mapping[int, Mapping[str, Sequence[bytes]]],
) -> str:
    """Returns the page; `films`: JPEG images by the index of the episode that is shown, and by camera."""
    refused = [one for one in episodes if one.faults]
    outcomes = Counter(one.label.outcome or "no label" for one in episodes)
    counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    fit = not refused and not faults
    verdict = "Fit for training." if fit else f"Not fit for training: {len(refused)} episodes are refused."
    parts = [
        f"<h1>{len(episodes)} episodes: {escape(counts)}</h1>",
        f'<p class="{"fit" if fit else "bad"}">{verdict}</p>',
        *(f'<p class="bad"><b>{escape(fault.name)}</b>: {escape(fault.why)}.</p>' for fault in faults),
        *(f"<p>{escape(remark)}</p>" for remark in remarks),
    ]
    if refused:
        parts += ["<h2>Refused</h2>", _list(_faults(one) for one in refused)]
    outliers = [one for one in episodes if one.outliers]
    if outliers:
        said = (f"<b>{escape(one.name)}</b>: {', '.join(one.outliers)}" for one in outliers)
        parts += ["<h2>Far from the other episodes</h2>", _list(said)]
    parts += ["<h2>Episodes</h2>", _table(episodes), "<h2>Spread</h2>", *_plots(episodes)]
    parts += ["<h2>The worst</h2>", *(_shown(episodes[i], of) for i, of in films.items())]
    parts.append(f"<script>{FILMS}</script>")
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Dataset report</title><style>{STYLE}</style>'
    return f"{head}<body>{''.join(parts)}</body></html>\n"


def _list(items: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


def _faults(one: EpisodeQuality) -> str:
    return _list_of(one.name, (f"<b>{escape(fault.name)}</b>: {escape(fault.why)}" for fault in one.faults))


def _list_of(name: str, items: Iterable[str]) -> str:
    return f"<b>{escape(name)}</b>{_list(items)}"


def _table(episodes: Sequence[EpisodeQuality]) -> str:
    known = [key for key in MEASURES if any(key in one.measures for one in episodes)]
    head = "".join(f"<th>{key}<br><small>{escape(MEASURES[key])}</small></th>" for key in known)
    rows = []
    for one in episodes:
        cells = "".join(
            f'<td class="{"far" if key in one.outliers else ""}">{number(one.measures.get(key))}</td>' for key in known
        )
        name = f'<td class="{"bad" if one.faults else ""}">{escape(one.name)}</td>'
        rows.append(f"<tr>{name}<td>{escape(one.label.outcome or '-')}</td>{cells}</tr>")
    return f'<div class="wide"><table><tr><th>episode</th><th>outcome</th>{head}</tr>{"".join(rows)}</table></div>'


def number(value: float | None) -> str:
    """Returns a number with three digits, or a dash for none."""
    return "-" if value is None else f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _plots(episodes: Sequence[EpisodeQuality]) -> list[str]:
    plots = []
    for key, meaning in MEASURES.items():
        at = [(float(i), one.measures[key], bool(one.faults)) for i, one in enumerate(episodes) if key in one.measures]
        if len({value for _, value, _ in at}) > 1:
            plots.append(_figure(f"{key} [{meaning}] of each episode", _points(at)))
    spread = spread_of_starts(episodes)
    for name, m in spread.items():
        at = [(one.starts[name][0], one.starts[name][1], bool(one.faults)) for one in episodes if one.starts.get(name)]
        caption = f"{name} at the start, from above [m]; {1e3 * m:.0f} mm from the mean (rms)"
        plots.append(_figure(caption, _points(at)))
    return plots


def _figure(caption: str, drawn: str) -> str:
    return f"<figure>{drawn}<figcaption>{escape(caption)}</figcaption></figure>"


def _points(at: Sequence[tuple[float, float, bool]]) -> str:
    x, y = _across([one[0] for one in at]), _down([one[1] for one in at])
    low, high = min(one[1] for one in at), max(one[1] for one in at)
    dots = "".join(
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{BAD if bad else FAIR}"/>'
        for a, b, (_, _, bad) in zip(x, y, at)
    )
    return _svg(f"{dots}{_labels(low, high)}")


def _labels(low: float, high: float) -> str:
    style = 'font-size="10" fill="#666" x="2"'
    return f'<text {style} y="10">{number(high)}</text><text {style} y="{HEIGHT - 2}">{number(low)}</text>'


def _svg(content: str) -> str:
    return f'<svg width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}">{content}</svg>'


def _across(values: Sequence[float] | np.ndarray) -> np.ndarray:
    return _scaled(values, 4 * EDGE, WIDTH - EDGE)


def _down(values: Sequence[float] | np.ndarray) -> np.ndarray:
    return _scaled(values, HEIGHT - EDGE, EDGE)


def _scaled(values: Sequence[float] | np.ndarray, first: int, last: int) -> np.ndarray:
    found = np.array(values, float)
    return first + (found - found.min()) / (float(np.ptp(found)) or 1.0) * (last - first)


def _shown(one: EpisodeQuality, films: Mapping[str, Sequence[bytes]]) -> str:
    drawn = []
    if len(one.speed) > 1:
        most_points = 400
        speed = one.speed[:: max(1, len(one.speed) // most_points)]
        x, y = _across(range(len(speed))), _down(speed)
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
        path = f'<polyline points="{line}" fill="none" stroke="{FAIR}"/>{_labels(speed.min(), speed.max())}'
        drawn.append(_figure(f"speed of the tool [m/s] over {len(one.speed) * GRID_S:.1f} s", _svg(path)))
    for name, images in films.items():
        camera = one.cameras[name]
        said = f"{name}: {camera.count} images, {camera.rate:.1f} a second; {TIMES:g} times as fast, a click stops it"
        every = (camera.span[1] - camera.span[0]) / len(images) / TIMES
        drawn.append(_film(said, [base64.b64encode(image).decode() for image in images], every))
    why = ", ".join([*dict.fromkeys(fault.name for fault in one.faults), *one.outliers])
    return f"<h3>{escape(one.name)}{f': {escape(why)}' if why else ''}</h3>{''.join(drawn)}"


def _film(caption: str, images: Sequence[str], every: float) -> str:
    """Returns a film of JPEG images, base64, that plays one `every` s."""
    first = f'<img alt="" src="data:image/jpeg;base64,{images[0]}">'
    slider = f'<input type="range" value="0" max="{len(images) - 1}">'
    data = f'<script type="application/json">{json.dumps(images)}</script>'
    shown = f"{first}{slider}<figcaption>{escape(caption)}</figcaption>{data}"
    return f'<figure class="film" data-every="{1e3 * every:.0f}">{shown}</figure>'
