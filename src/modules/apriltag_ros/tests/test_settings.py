"""The keys of settings.yaml and tags.yaml: what is accepted, and what is said about the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from apriltag_ros.settings import KEYS, detector_settings, targets
from common.errors import ConfigError

CONFIG = Path(__file__).parents[1] / "config"

PUBLISHED = {  # the settings file of the published package in 2019
    "tag_family": "tag36h11", "tag_threads": 2, "tag_decimate": 1.0, "tag_blur": 0.0, "tag_refine_edges": 1,
    "tag_debug": 0, "publish_tf": True,
}  # fmt: skip


def test_the_shipped_files_are_accepted_and_state_units():
    values = yaml.safe_load((CONFIG / "settings.yaml").read_text())
    assert set(values) <= KEYS
    assert detector_settings(values).publish_tf
    (tag,) = targets(yaml.safe_load((CONFIG / "tags.yaml").read_text()))
    assert (tag.name, tag.tags[0].id, tag.tags[0].size) == ("tag_frame", 0, 0.097)
    for line in (CONFIG / "settings.yaml").read_text().splitlines():
        assert not line.strip() or "#" in line, line


def test_a_tag_may_have_a_frame_with_a_slash_which_tf_takes_off():
    (tag,) = targets({"standalone_tags": [{"id": 0, "size": 0.1, "name": "/tag_frame"}]})
    assert tag.name == "tag_frame"


def test_a_users_file_of_2019_is_accepted():
    assert detector_settings(PUBLISHED).max_hamming_dist == 2


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"tag_family": "tagStandard41h12"}, "tag_family is 'tagStandard41h12', but must be one of tag36h11"),
        ({"tag_refine_edges": 0}, "tag_refine_edges is 0"),
        ({"tag_debug": 1}, "tag_debug is 1"),
        ({"tag_decimte": 1.0}, "tag_decimte is not a known key"),
        ({"transport_hint": "compressed"}, "transport_hint is 'compressed'"),
    ],
)
def test_faults_of_settings(change, sentence):
    with pytest.raises(ConfigError, match="^" + sentence.split("'")[0]) as error:
        detector_settings({**PUBLISHED, **change})
    assert sentence in str(error.value)


def test_names_and_places_of_tags():
    found = targets(
        {
            "standalone_tags": [{"id": 7, "size": 0.05}],
            "tag_bundles": [
                {"layout": [{"id": 1, "size": 0.1}, {"id": 2, "size": 0.1, "x": 0.3, "qw": 0.0, "qz": 1.0}]},
                {"name": "box", "layout": [{"id": 7, "size": 0.05}]},
            ],
        }
    )
    assert [t.name for t in found] == ["tag_7", "bundle_0", "box"]
    second = found[1].tags[1]
    np.testing.assert_allclose(second.corners[0], [0.35, -0.05, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({}, "both empty"),
        ({"standalone_tags": 5}, "standalone_tags is 5, but must be a list"),
        ({"standalone_tags": [5]}, "standalone_tags[0]/ is 5, but must be a mapping"),
        ({"standalone_tags": [{"id": 0, "size": 8}]}, "[0]/size is 8, but must be a finite number in [0.002, 2] m"),
        ({"standalone_tags": [{"id": 0, "size": 0.000097}]}, "standalone_tags[0]/size is 9.7e-05, but must be"),
        ({"tag_bundles": [{"layout": [{"id": 0, "size": 60, "x": -105}]}]}, "tag_bundles[0]/layout[0]/x is -105, but"),
        ({"tag_bundles": [{"layout": [{"id": 0, "size": 0.06, "x": 10.5}]}]}, "layout[0]/x is 10.5, but must be"),
        ({"standalone_tags": [{"id": 0, "size": 0.1, "nmae": "a"}]}, "standalone_tags[0]/nmae is not a known key"),
        ({"standalone_tags": [{"id": 0, "size": 0.1, "name": ""}]}, "standalone_tags[0]/name is ''"),
        ({"standalone_tags": [{"id": 0, "size": 0.1}] * 2}, "tag 0 is listed twice"),
        (
            {"standalone_tags": [{"id": 0, "size": 0.1}], "tag_bundles": [{"layout": [{"id": 0, "size": 0.2}]}]},
            "The tag 0 has the sizes [0.1, 0.2] m",
        ),
        ({"tag_bundles": [{"name": "a"}]}, "tag_bundles[0]/layout has no tags"),
        ({"tag_bundles": [{"layout": [{"id": 0, "size": 0.1, "qw": 0.0}]}]}, "has norm 0 instead of 1"),
    ],
)
def test_faults_of_tags(values, sentence):
    with pytest.raises(ConfigError) as error:
        targets(values)
    assert sentence in str(error.value)
