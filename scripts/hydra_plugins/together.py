"""The launcher `hydra/launcher=together`: all jobs of a sweep in one process, in lockstep."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict


class Together(Launcher):
    """Run all jobs in lockstep on the device that the config names; what all of them do at once is one batch."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Take what a job is made of."""
        self.config, self.context, self.task = config, hydra_context, task_function

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run jobs, and return what came of each."""
        from dynasindy.together import Carried, Company

        setup_globals()
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        # Hydra keeps the settings of the present job in one place; here each job finds its own again.
        hydra = HydraConfig.instance()
        before = hydra.cfg
        try:
            configs = [self._composed(list(words), initial_job_idx + k) for k, words in enumerate(job_overrides)]
            company = Company(_device(configs), Carried(lambda: hydra.cfg, lambda kept: setattr(hydra, "cfg", kept)))
        except ValueError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        try:
            return [self._came(found) for found in company.run([self._job(config) for config in configs])]
        finally:
            hydra.cfg = before

    def _composed(self, overrides: list[str], number: int) -> DictConfig:
        config = self.context.config_loader.load_sweep_config(self.config, overrides)
        with open_dict(config):
            config.hydra.job.id = config.hydra.job.num = number
        return config

    def _job(self, config: DictConfig) -> Any:
        return lambda: run_job(
            hydra_context=self.context,
            task_function=self.task,
            config=config,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )

    @staticmethod
    def _came(found: Any) -> JobReturn:
        if not isinstance(found, BaseException):
            assert isinstance(found, JobReturn)
            return found
        came = JobReturn(status=JobStatus.FAILED)
        came._return_value = found
        return came


def _device(configs: Sequence[DictConfig]) -> str:
    """Return the device of all jobs.

    Raises:
        ValueError: They name several.
    """
    found = sorted({str(config.get("device", "cpu")) for config in configs})
    if len(found) > 1:
        raise ValueError(
            f"device={','.join(found)}: jobs in lockstep share one device; name one, or choose another hydra/launcher"
        )
    return found[0]
