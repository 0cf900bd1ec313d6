"""Which rig may use which calibration."""

import pytest

from common.errors import ConfigError
from common.simulated import any_simulated, doubt, origin, refusal, said_by

UNKNOWN = None


@pytest.mark.parametrize("rig", [True, False, UNKNOWN])
@pytest.mark.parametrize("made", [True, False, UNKNOWN])
def test_only_a_rig_that_is_simulated_uses_what_was_simulated_and_only_it_has_no_doubt(made, rig):
    why = refusal("The calibration a.yaml", made, rig, "Measure again.")
    assert bool(why) is (made is True and rig is not True)
    assert not why or (why.startswith("The calibration a.yaml ") and why.endswith(" Measure again."))
    asked = doubt("The calibration a.yaml", made, rig)
    assert bool(asked) is (made is UNKNOWN and rig is not True)
    assert not (why and asked)


@pytest.mark.parametrize(
    ("devices", "made"),
    [
        ((False, False), False),
        ((False, True), True),
        ((UNKNOWN, True), True),
        ((UNKNOWN, False), UNKNOWN),
        ((True,), True),
        ((UNKNOWN,), UNKNOWN),
    ],
)
def test_one_simulated_device_is_enough_and_one_unknown_leaves_a_doubt(devices, made):
    assert any_simulated(*devices) is made
    assert len({origin(each) for each in (True, False, UNKNOWN)}) == 3


@pytest.mark.parametrize(("said", "found"), [({}, UNKNOWN), ({"simulated": True}, True), ({"simulated": False}, False)])
def test_the_key_of_a_file_counts_beside_any_others(said, found):
    assert said_by({"camera_name": "a", **said}, "a.yaml: ") is found


@pytest.mark.parametrize("value", [None, "maybe", "true", 1, []])
def test_another_value_is_refused_by_file_and_key(value):
    with pytest.raises(ConfigError, match="^a.yaml: simulated is .*, but must be true or false"):
        said_by({"simulated": value}, "a.yaml: ")
