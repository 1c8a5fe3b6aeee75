"""Evaluate a policy: `python scripts/evaluate.py run=PATH 'scenarios=[step,sine,noise]' [animate=true]`."""

from functools import partial
from pathlib import Path
from typing import Any

from cli import command


@command("evaluate")
def main(cfg: Any) -> None:
    """Run the policy in each scenario, print its table and write its figures."""
    from saved_run import load_config, load_observer, load_policy, load_scenario

    from dynasindy.control.controller import IntegralAction
    from dynasindy.evaluation.metrics import to_text
    from dynasindy.evaluation.scenarios import evaluate
    from dynasindy.evaluation.tracking_criteria import WITHIN, judge_control, judge_tracking
    from dynasindy.progress import say
    from dynasindy.safe_io import output_folder
    from dynasindy.sentences import lines
    from dynasindy.sindy import SindyModel
    from dynasindy.viz.animation import animate
    from dynasindy.viz.response import draw_evaluation

    folder = Path(cfg.run)
    config = load_config(folder, cfg.plugins)
    env, policy = load_policy(config, folder)
    observer = load_observer(config, folder, env)
    name = "policy"
    if cfg.integral:
        policy, name = IntegralAction(policy, env), "policy, integral action"
    out = output_folder(folder, "evaluation_integral" if cfg.integral else "evaluation")
    within, verdicts = config.evaluation.get("within", WITHIN), []
    system = env.system if env.system.known else SindyModel.load(folder / "model.json")
    for scenario in [load_scenario(each, config, env) for each in cfg.scenarios]:  # a wrong one before the first
        result = evaluate(env, policy, scenario, observer)
        result.save(out)
        draw_evaluation(result, out, name, cfg.formats)
        if cfg.animate:
            animate(result, out / f"{scenario.name}.gif")
        table = to_text(result.summary(), result.title, result.state_units, result.told_steady_seconds)
        say(table, *lines(result.beyond_targets), "")
        rerun = partial(evaluate, env, policy, scenario, observer) if env.system.known else None
        _, verdict = judge_control([judge_tracking(result, system, rerun)], within)
        verdicts.append(f"  {scenario.name}: {verdict}")
    say("Verdict in each scenario:", *verdicts, f"Figures, tables and trajectories: {out}")


if __name__ == "__main__":
    main()
