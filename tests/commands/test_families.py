"""Names of errors round-trip, and what is no error is refused with what would be one."""

import pytest

from lerobot_dexflex.commands.families import FAMILIES, NO_ERRORS, CommandErrors
from lerobot_dexflex.errors import DexFlexError

NAMES = [
    *("noise_2mm", "noise_4mm", "scale_1.5", "scale_0", "delay_2", "removal_3mm"),
    *("typical", "novice+noise_1mm"),
    *("bias_0.5mm", "freeze_8", "dropout_16", "delay_2+noise_1mm", "noise_4mm+removal_2mm"),
]


@pytest.mark.parametrize("name", ["clean", *NAMES])
def test_names_round_trip(name):
    assert CommandErrors.parse(name).name == name


def test_every_family_is_tried_above_and_no_errors_are_clean():
    assert {family for name in NAMES for family in CommandErrors.parse(name).families} == set(FAMILIES)
    assert CommandErrors.parse("clean") == NO_ERRORS
    assert not NO_ERRORS


def test_a_level_is_part_of_the_errors_and_stands_first():
    errors = CommandErrors.parse("noise_1mm+typical")
    assert (errors.level, errors.families, errors.name) == ("typical", ("noise",), "typical+noise_1mm")
    assert CommandErrors.parse("steady")
    with pytest.raises(DexFlexError, match=r"Unknown level 'expert'\. Valid: steady, typical, novice"):
        CommandErrors(level="expert")


def test_strengths_are_si_and_errors_have_one_order():
    errors = CommandErrors.parse("removal_2mm+noise_4mm")
    assert errors == CommandErrors.of(noise=0.004, removal=0.002)
    assert errors.name == "noise_4mm+removal_2mm"


def test_events_last_as_long_as_the_table_or_the_strength_says():
    steps = {error.family: error.steps for error in CommandErrors.parse("removal_2mm+freeze_3+noise_1mm")}
    assert steps == {"removal": 8, "freeze": 3, "noise": 0}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("typo_2mm", r"'typo_2mm' is no command error. Valid: delay_<steps>, .*noise_<mm>"),
        ("jitter_4mm", "'jitter_4mm' is no command error"),
        ("noise_xmm", "'noise_xmm' is no command error"),
        ("noise", "'noise' is no command error"),
        ("noise_2", "'noise_2' is no command error"),
        ("clean+noise_2mm", "'clean' is no command error"),
        ("", "'' is no command error"),
        ("delay_1.5", "'delay', by so many steps, must be a whole number, 0 or more. Got 1.5"),
        ("freeze_0", "'freeze', for so many steps, must be a whole number, 1 or more. Got 0.0"),
        ("scale_-1", "'scale', factor of every motion, must be 0 or more. Got -1.0"),
        ("noise_nanmm", "must be 0 or more. Got nan"),
        ("noise_1mm+noise_2mm", "names a family twice"),
        ("steady+novice", "'steady\\+novice' names steady and novice; a person has one level"),
        ("typical_2mm", "'typical_2mm' is no command error. Valid: .*steady, typical, novice"),
    ],
)
def test_what_is_no_error_is_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        CommandErrors.parse(name)
