"""Compare settings over seeds: `python scripts/ablation.py [system=tras] [setting=direct,oracle] ['seed=range(5)']`."""

import traceback
from pathlib import Path

from command import Sweep, command
from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from mistakes import in_words, mendable
from omegaconf import DictConfig


class Gathering(Callback):
    """When every job is done, make the tables and figures of all finished runs."""

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Gather what lies in the folder of the sweep; what is in the way is told as an error when all is over."""
        from dynasindy.evaluation.ablation import gather
        from dynasindy.progress import say
        from dynasindy.viz.learning import draw_ablation

        root, results, level = Path(config.hydra.sweep.dir), Path(config.results), instantiate(config.level)
        try:
            if not gather(root, results, level):
                print(f"No run in {root} has finished, so there are no tables and figures.")
                return
            draw_ablation(results, level.error, share=level.share)
            say((results / "ablation.md").read_text(), f"Tables and figures: {results}")
        except Exception as error:  # Hydra would make a warning of it, and the command would end with code 0
            if not mendable(error):
                traceback.print_exc()
            Sweep.wrong.append(in_words(error, "ablation"))


@command("ablation")
def main(cfg: DictConfig) -> None:
    """Run one job, unless it is finished."""
    from job import run_job

    from dynasindy.evaluation.ablation import errors_in_words

    folder = Path(cfg.folder)
    done = run_job(cfg, progress=False)
    if done.before:
        print(f"finished before: {folder}")
        return
    seconds = done.metrics["cost"]["wall_seconds"]
    print(f"finished: {folder}, steady-state error {errors_in_words(done.metrics)}, {seconds:.0f} s")


if __name__ == "__main__":
    main()
