"""Laws of the view for the headset: lens maps, depth-image-based rendering, and the age of the image."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from depth_scene import RGB, load
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from common.config import parse
from common.errors import ConfigError, DeviceError
from vision.stereo.lens import BLUE, CENTRES, GREEN, HEIGHT, RED, WIDTH, Dk2Lens, directions
from vision.stereo.view import (
    LEFT,
    RIGHT,
    ImageAge,
    StereoView,
    StereoViewConfig,
    WebConfig,
    WindowConfig,
    age_text,
    eye_map,
    inverse_depth,
    mark_age,
)

CAMERA = pinhole("test", 64, 48, [[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]])
CONFIG = load("stereo_view.yaml")


def config(**changes):
    return parse(StereoViewConfig, {**CONFIG, **changes})


def stripes(camera=CAMERA):
    """An image in which each column has its own colour, and none is black."""
    columns = np.linspace(40.0, 250.0, camera.width).astype(np.uint8)
    return np.broadcast_to(columns[None, :, None], (camera.height, camera.width, 3)).copy()


class TestLens:
    pixel = st.tuples(st.floats(0.0, WIDTH), st.floats(0.0, HEIGHT))

    @given(pixel, st.sampled_from([0, 1]))
    def test_the_centre_looks_straight_ahead_and_red_inside_green_inside_blue(self, pixel, eye):
        assert np.allclose(directions(CENTRES[eye], eye), 0.0)
        red, green, blue = (np.linalg.norm(directions(pixel, eye, c)) for c in (RED, GREEN, BLUE))
        assert red <= green <= blue

    @given(pixel)
    def test_the_eyes_are_mirror_images(self, pixel):
        u, v = pixel
        left, right = directions((u, v), 0), directions((WIDTH - u, v), 1)
        np.testing.assert_allclose(left, right * (-1.0, 1.0), atol=1e-9)

    @given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from([0, 1]), st.sampled_from([RED, GREEN, BLUE]))
    def test_every_direction_is_on_exactly_one_pixel(self, x, y, eye, colour):
        """Along each ray from the centre the angle grows, so bisection finds the pixel."""
        wanted = np.array([x, y])
        if np.linalg.norm(wanted) < 1e-6:
            return
        ray = wanted / np.linalg.norm(wanted)
        low, high = 0.0, 900.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            nearer = np.linalg.norm(directions(CENTRES[eye] + middle * ray, eye, colour)) < np.linalg.norm(wanted)
            low, high = (middle, high) if nearer else (low, middle)
        np.testing.assert_allclose(directions(CENTRES[eye] + low * ray, eye, colour), wanted, atol=1e-9)

    def test_the_field_of_view_is_that_of_the_dk2(self):
        edges = {(0, 0.0): 46.6, (0, WIDTH): 47.5}  # the left eye's outer and inner edge, in degrees
        for (eye, u), degrees in edges.items():
            x = abs(directions((u, 540.0), eye)[0])
            assert np.degrees(np.arctan(x)) == pytest.approx(degrees, abs=0.5)

    def test_a_map_undoes_the_lens(self):
        """An image whose colour says its column and row, drawn for the screen, shows each direction's own colour."""
        camera = pinhole("ramp", 256, 256, [[200.0, 0.0, 127.5], [0.0, 200.0, 127.5], [0.0, 0.0, 1.0]])
        u, v = np.meshgrid(np.arange(256, dtype=np.uint8), np.arange(256, dtype=np.uint8))
        image = np.stack((u, u, u), axis=-1), np.stack((v, v, v), axis=-1)
        lens = Dk2Lens(camera, 1.0, True)
        columns, rows = (lens.draw(p, p) for p in image)
        for eye in (0, 1):
            for colour in (RED, GREEN, BLUE):
                for du, dv in ((0, 0), (150, -90), (-200, 120)):
                    at = int(CENTRES[eye][0]) + du, 540 + dv
                    x, y = directions((at[0] + 0.5, at[1] + 0.5), eye, colour)
                    column = eye * WIDTH + at[0]
                    assert columns[at[1], column, colour] == pytest.approx(200.0 * x + 127.5, abs=1.0)
                    assert rows[at[1], column, colour] == pytest.approx(200.0 * y + 127.5, abs=1.0)

    def test_without_colours_of_its_own_every_colour_is_bent_as_green(self):
        camera = pinhole("ramp", 256, 256, [[200.0, 0.0, 127.5], [0.0, 200.0, 127.5], [0.0, 0.0, 1.0]])
        image = np.random.default_rng(1).integers(1, 255, (256, 256, 3), np.uint8)
        plain, chromatic = (Dk2Lens(camera, 1.0, c).draw(image, image) for c in (False, True))
        np.testing.assert_array_equal(plain[..., GREEN], chromatic[..., GREEN])
        assert not np.array_equal(plain[..., BLUE], chromatic[..., BLUE])

    def test_larger_magnification_covers_more_of_the_screen(self):
        filled = [np.count_nonzero(Dk2Lens(CAMERA, m, False).draw(stripes(), stripes())) for m in (0.5, 1.0, 2.0)]
        assert filled == sorted(filled) and filled[0] < filled[2]


class TestDepth:
    @given(st.floats(0.5, 20.0))
    def test_a_plane_shifts_by_focal_length_times_distance_of_the_eyes_over_depth(self, z):
        shift = 0.5 * 60.0 * 0.064 * inverse_depth(np.full((4, 64), z, np.float32), 0.4, 2.0)
        columns = np.arange(64)
        left, right = (eye_map(shift, eye) for eye in (LEFT, RIGHT))
        np.testing.assert_allclose(right - left, 60.0 * 0.064 / z, atol=1e-4)
        np.testing.assert_allclose(left[2], columns - 0.5 * 60.0 * 0.064 / z, atol=1e-4)

    @given(st.integers(0, 2**32 - 1))
    @settings(max_examples=30)
    def test_whatever_the_depth_no_map_has_a_hole_or_a_nan(self, seed):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(-1.0, 5.0, (8, 40)).astype(np.float32)
        depth[rng.random(depth.shape) < rng.random()] = np.nan
        depth[rng.random(depth.shape) < 0.05] = np.inf
        near = inverse_depth(depth, 0.4, 2.0)
        assert np.isfinite(near).all() and (near > 0.0).all() and near.max() <= np.float32(1.0 / 0.4)
        for eye in (LEFT, RIGHT):
            found = eye_map(4.0 * near, eye)
            assert np.isfinite(found).all()
            margin = int(4.0 / 0.4) + 1
            inner = found[:, margin:-margin]
            assert (inner >= -0.5).all() and (inner <= 39.5).all()

    @given(st.integers(0, 2**32 - 1))
    @settings(max_examples=60, deadline=None)
    def test_holes_show_what_is_behind_pixel_by_pixel(self, seed):
        rng = np.random.default_rng(seed)
        width = 24
        depth = rng.uniform(0.3, 5.0, (6, width)).astype(np.float32)
        depth[rng.random(depth.shape) < rng.random()] = np.nan
        known = np.isfinite(depth)
        if not known.any():
            return
        near = inverse_depth(depth, 0.4, 2.0)
        for row, column in np.ndindex(depth.shape):
            beside = [
                c[-1]
                for c in (np.flatnonzero(known[row, :column]), np.flatnonzero(known[row, column:])[::-1] + column)
                if c.size
            ]
            far = max((depth[row, c] for c in beside), default=np.nanmax(depth))
            expected = depth[row, column] if known[row, column] else far
            assert near[row, column] == pytest.approx(1.0 / max(expected, 0.4), rel=1e-6)
        shift = 7.0 * near
        for eye in (LEFT, RIGHT):
            found = eye_map(shift, eye)
            for row in range(6):
                shown = {}
                for u in range(width):
                    t = int(np.rint(np.float32(u) + eye * shift[row, u]))
                    if 0 <= t < width and shift[row, u] >= shown.get(t, (-1.0,))[0]:
                        shown[t] = shift[row, u], t - eye * shift[row, u]
                for t in range(width):
                    left, right = (
                        max((c for c in shown if c <= t), default=None),
                        min((c for c in shown if c >= t), default=None),
                    )
                    if left is None or right is None:
                        edge = left if right is None else right
                        expected = np.nan if edge is None else shown[edge][1] + t - edge
                    else:
                        expected = min((shown[left], shown[right]), key=lambda s: s[0])[1]
                    if not np.isnan(expected):
                        assert found[row, t] == pytest.approx(expected, abs=1e-4)

    def test_what_has_no_depth_counts_as_its_farther_neighbour(self):
        nan = np.nan
        depth = np.array([[1, nan, nan, 3], [nan] * 4, [nan, 2, 0, -1], [nan, 2, nan, 2.5], [0.1, nan, np.inf, 0.2]])
        expected = [[1, 3, 3, 3], [3, 3, 3, 3], [2, 2, 2, 2], [2, 2, 2.5, 2.5], [0.4, 0.4, 0.4, 0.4]]
        np.testing.assert_allclose(1.0 / inverse_depth(depth.astype(np.float32), 0.4, 5.0), expected, rtol=1e-6)
        np.testing.assert_allclose(1.0 / inverse_depth(np.full((2, 3), nan, np.float32), 0.4, 5.0), 5.0)


class TestView:
    def test_without_depth_both_eyes_see_the_same_image_at_the_flat_distance(self):
        view = StereoView(CAMERA, config(flat_distance=0.4, lens="none"))
        seen = view.eyes(stripes(), None)
        assert not seen.deep
        shift = round(0.5 * 60.0 * 0.064 / 0.4)
        np.testing.assert_array_equal(seen.left[:, shift:], stripes()[:, :-shift])
        np.testing.assert_array_equal(seen.right[:, :-shift], stripes()[:, shift:])
        assert not seen.left[:, :shift].any() and not seen.right[:, -shift:].any()

    def test_where_no_depth_is_wanted_it_is_the_doubled_image_of_2019(self):
        view = StereoView(CAMERA, config(depth=False, flat_distance=0.4, lens="none"))
        seen = view.eyes(stripes(), None)
        np.testing.assert_array_equal(view.screen.draw(seen.left, seen.right), np.hstack((stripes(), stripes())))

    def test_the_real_camera_fills_the_screen_of_the_dk2_without_nan(self):
        view = StereoView(RGB, config())
        rng = np.random.default_rng(0)
        colour = rng.integers(0, 255, (RGB.height, RGB.width, 3), np.uint8)
        depth = rng.uniform(0.5, 3.0, (RGB.height, RGB.width)).astype(np.float32)
        depth[100:200, 100:300] = np.nan
        seen = view.eyes(colour, depth)
        screen = view.screen.draw(seen.left, seen.right)
        assert screen.shape == (1080, 1920, 3)
        assert 0.2 < np.count_nonzero(screen.any(axis=-1)) / screen[..., 0].size < 0.4

    def test_a_image_of_another_size_is_refused(self):
        view = StereoView(CAMERA, config())
        with pytest.raises(ValueError, match="colour"):
            view.eyes(stripes()[:-1], None)
        with pytest.raises(ValueError, match="depth"):
            view.eyes(stripes(), np.ones((48, 65), np.float32))


class TestAge:
    def test_only_another_stamp_is_a_new_image(self):
        age = ImageAge()
        assert age.age(1.0) is None
        assert age.is_new(7.0)
        age.shown(7.0, 10.0)
        assert not age.is_new(7.0)
        assert age.age(13.0) == 3.0
        assert age.is_new(6.0)  # a recording that starts again
        age.shown(6.0, 13.0)
        assert age.age(13.5) == 0.5

    def test_the_text_and_the_mark(self):
        assert [age_text(a) for a in (None, 3.21, 120.0)] == ["no image yet", "3.2 s old", "2 min old"]
        image = np.full((480, 640, 3), 200, np.uint8)
        marked = mark_age(image, 3.2)
        assert marked.shape == image.shape and (image == 200).all()
        assert np.median(marked) == 80
        rows, columns = np.nonzero(marked[..., 0] > 200)
        assert abs(rows.mean() - 240) < 20 and abs(columns.mean() - 320) < 20


def test_the_settings_are_complete_and_a_contradiction_is_refused():
    assert config().lens == "dk2"
    with pytest.raises(ConfigError, match="nearest"):
        config(nearest=3.0)
    with pytest.raises(ConfigError, match="lens"):
        config(lens="vive")


def test_every_line_of_the_yaml_states_its_unit():
    from depth_scene import CONFIG as FOLDER

    lines = [x for x in (FOLDER / "stereo_view.yaml").read_text().splitlines() if x and not x.startswith("#")]
    assert all("#" in line for line in lines) and len(lines) == len(yaml.safe_load("\n".join(lines)))


WEB = {"host": "127.0.0.1", "port": 0, "page": "/page.html", "certificate": "", "key": ""}


@pytest.mark.parametrize(
    ("schema", "values", "key"),
    [
        (WindowConfig, {"output": 1}, "output"),
        (WebConfig, {**WEB, "port": "8000"}, "port"),
        (WebConfig, {**WEB, "page": "page.html"}, "page"),
        (WebConfig, {**WEB, "certificate": "/certificate.pem"}, "key"),
    ],
)
def test_faults_of_window_and_page(schema, values, key):
    with pytest.raises(ConfigError, match=key):
        parse(schema, values)


@pytest.mark.ros
def test_a_page_that_cannot_be_read_is_named():
    from vision.ros.stereo.web_node import StereoWeb

    with pytest.raises(DeviceError, match="/page.html"):
        StereoWeb(parse(WebConfig, WEB))
