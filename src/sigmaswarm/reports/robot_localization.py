"""Section of README.md with the accuracy of an exported configuration of robot_localization."""

from sigmaswarm.scoring.evaluation import Evaluation
from sigmaswarm.scoring.methods import AGAINST, BASELINE

MEASURES = ("position_rmse_m", "heading_rmse_deg", "outage_drift_m")


def accuracy_section(evaluation: Evaluation) -> str:
    known = [m for m in MEASURES if any(evaluation.mean(k, m) is not None for k in ("tuned", BASELINE))]
    heads = " | ".join(evaluation.measures[m].heading for m in known)
    lines = [f"| filter | {heads} |", "|---" * (len(known) + 1) + "|"]
    names = {
        BASELINE: "default process noise, same inputs",
        "tuned": "ekf.yaml",
        AGAINST: evaluation.names.get(AGAINST, ""),
    }
    for method, name in names.items():
        if method in evaluation.names:
            values = [evaluation.mean(method, m) for m in known]
            lines.append(f"| {name} | " + " | ".join("-" if v is None else f"{v:.3g}" for v in values) + " |")
    sentences = [
        _compared(evaluation, over, names[over], known[0])
        for over in (BASELINE, AGAINST)
        if over in evaluation.names and known
    ]
    training = [name for name, scores in evaluation.drives.items() if scores.record.seen_s]
    if training:
        sentences.append(
            f"The filter was tuned on {', '.join(training)}, so expect larger errors on other drives."
        )
    drives = ", ".join(evaluation.drives)
    return "\n".join([f"\n## Accuracy on {drives}\n", *lines, "", *sentences, ""])


def _compared(evaluation: Evaluation, other: str, name: str, measure: str) -> str:
    tuned, theirs = evaluation.mean("tuned", measure), evaluation.mean(other, measure)
    if not tuned or not theirs:
        return f"The errors of ekf.yaml and of {name} can't be compared, since one of these filters failed."
    title = evaluation.measures[measure].title
    if other == AGAINST and theirs < tuned:
        return (
            f"The {title} of the {name.removeprefix('other ')} is {1 - theirs / tuned:.0%} lower: {theirs:.3g} m "
            f"instead of {tuned:.3g} m."
        )
    change = 1 - tuned / theirs
    return f"The {title} of ekf.yaml is {abs(change):.0%} {'lower' if change >= 0 else 'HIGHER'} than with {name}."
