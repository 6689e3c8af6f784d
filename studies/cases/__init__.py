"""Many independent cases of one study: computed in parallel, each kept as soon as it is done, none computed twice."""

from studies.cases.journal import Failure
from studies.cases.program import PackageFile
from studies.cases.run import Changed, Finished, Options, results_of, run_cases
from studies.cases.study import Study
from studies.cases.workers import Workers

__all__ = ["Changed", "Failure", "Finished", "Options", "PackageFile", "Study", "Workers", "results_of", "run_cases"]
