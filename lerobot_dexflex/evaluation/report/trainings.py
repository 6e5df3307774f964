"""The tables of a comparison over several trainings, as Markdown."""

from lerobot_dexflex.evaluation.report.table import as_markdown, mean_text, rate_header, rate_rows
from lerobot_dexflex.evaluation.trainings import OverTrainings

_METHOD_HEADER = ("letters", "time [s]", "median [s]", "holding", "drops")
_PAIR_HEADER = ("pair", "only first", "only second", "p (Holm)", "gain")
_EACH = "each training"


def markdown(found: OverTrainings, against: str = "") -> str:
    """Return success, times and drops by method, the paired tests, and what the columns mean.

    Args:
        found: What to show.
        against: Show only the tests against this method; all of them if empty.
    """
    parts = [_methods(found), *([_pairs(found, against)] if found.pairs else []), _meanings(found)]
    return "\n\n".join(parts)


def _methods(found: OverTrainings) -> str:
    letters = found.summary.letters
    header = ["interface", *rate_header(found.summary)[1:], *_METHOD_HEADER]
    rows = [
        [
            f"`{name}`",
            *cells,
            letters.get(name, "-"),
            mean_text(method.time, 1),
            "-" if method.median is None else f"{method.median:.1f}",
            mean_text(method.holding, 2),
            mean_text(method.drops, 2),
            *_each(method.success),
        ]
        for (name, *cells), method in zip(rate_rows(found.summary), found.methods, strict=True)
    ]
    return as_markdown([*header, *_each_header(found)], rows)


def _pairs(found: OverTrainings, against: str) -> str:
    rows = [
        [
            f"`{pair.test.first}` vs `{pair.test.second}`",
            str(pair.test.only_first),
            str(pair.test.only_second),
            f"{pair.test.p_value_holm:.2g}",
            mean_text(pair.gain, 0, "+"),
            *_each(pair.each, "+"),
        ]
        for pair in found.pairs
        if pair.test.concerns(against)
    ]
    return as_markdown([*_PAIR_HEADER, *_each_header(found)], rows)


def _each_header(found: OverTrainings) -> list[str]:
    return [_EACH] if len(found.names) > 1 else []


def _each(values: tuple[float, ...], sign: str = "") -> list[str]:
    return [", ".join(f"{value:{sign}.0f}" for value in values)] if len(values) > 1 else []


def _meanings(found: OverTrainings) -> str:
    several = len(found.names) > 1
    counts = " to ".join(str(n) for n in dict.fromkeys((found.summary.counts[0], found.summary.counts[-1])))
    parts = [
        f"{len(found.names)} trainings" if several else "One training",
        f", {counts} rollouts per cell. Success with Wilson 95 % intervals over all rollouts. Time to ",
        "success: restricted mean, a failure counted as the task's limit, and Kaplan-Meier median.",
    ]
    if found.pairs:
        parts += [
            f" Exact McNemar tests on all paired episodes{' of the same training' if several else ''}, ",
            "adjusted by Holm over all pairs; methods that share a letter are not significantly different ",
            "(5 %). Gain: average over the tasks of second - first [% points].",
        ]
    if several:
        parts += [
            " Other 95 % intervals: trainings are resampled, then episodes within tasks, so that they tell ",
            f"of trainings of this kind; p-values and letters tell of these {len(found.names)}. Each ",
            f"training: average over the tasks, of {', '.join(f'`{name}`' for name in found.names)}.",
        ]
    else:
        parts += [" Other 95 % intervals: episodes are resampled within tasks; they tell of this training."]
    return "".join(parts)
