"""A Dask cluster of separate processes: the same bytes as with threads, and failures reported in one line."""

import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from dask_processes import OTHER_VERSION, Processes
from sigmaswarm import (
    FilterParameters,
    StudyConfig,
    compare,
    evaluate,
    read_drive,
    simulate,
    tune,
    write_drive,
)
from sigmaswarm.cli import main
from sigmaswarm.cli.simulate import simulated_on
from sigmaswarm.datasets.cluster import (
    BASE_MEMORY,
    USABLE_MEMORY,
    CachedDrive,
    Cluster,
    ClusterError,
    DriveCache,
    connected,
)
from sigmaswarm.datasets.remote import Assignment, assign_drives, remote_datasets, source_of
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.design import make_design
from sigmaswarm.experiments.study.scores import score_all
from sigmaswarm.scoring.batch import PassOptions
from sigmaswarm.scoring.remote import make_scorer
from sigmaswarm.tuning.batch import require_fit
from support import assert_same, file_contents

pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")

FILTER = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0), nominal_interval=0.01)
SMALL = {"particles": 6, "generations": 3, "model": "planar5", "objective": "truth-rmse + 0.2 nees"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four short drives; one of them in Parquet."""
    place = tmp_path_factory.mktemp("fleet")
    drives = [simulate("turns", run=run, gps="white-1m") for run in range(4)]
    return [write_drive(d, place / d.name, form="parquet" if k == 1 else "csv") for k, d in enumerate(drives)]


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with Processes(tmp_path_factory.mktemp("dask"), forked=True) as running:
        yield running


@pytest.fixture
def client(processes: Processes):
    with connected(processes.address) as client:
        client.wait_for_workers(2, timeout=60)
        yield client


@pytest.fixture(scope="module")
def on_threads(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a tuning on threads leaves, with two drives held back."""
    out = tmp_path_factory.mktemp("threads") / "out"
    drives = [read_drive(folder) for folder in folders]
    tune(drives[:3], validation=drives[3:], out=out, **SMALL)
    return file_contents(out)


def test_a_tuning_ends_in_the_bytes_of_one_on_threads(client, folders, on_threads, tmp_path):
    given = [read_drive(folders[0]), *folders[1:3]]  # drives and places may stand side by side
    tune(given, validation=folders[3], out=tmp_path / "out", cluster=client, **SMALL)
    assert file_contents(tmp_path / "out") == on_threads


@pytest.mark.long
def test_a_race_and_an_evaluation_are_those_of_threads(client, folders):
    drives = [read_drive(folder) for folder in folders]
    asked = SMALL | {"racing": True}
    here, there = tune(drives, **asked), tune(folders, cluster=client, **asked)
    assert (here.cost, here.steps) == (there.cost, there.steps)
    assert here.parameters == there.parameters
    same = [drives[0], drives[0], drives[2]]  # two of one name
    told = [evaluate(same, FILTER, seen=here.seen, cluster=c) for c in (None, client)]
    assert told[0].to_dict() == told[1].to_dict()
    assert told[0].setup == told[1].setup


def test_a_killed_worker_changes_no_bit_and_the_next_one_takes_over(folders, on_threads, tmp_path):
    with Processes(tmp_path / "dask", forked=True) as running, connected(running.address) as client:
        client.wait_for_workers(2, timeout=60)

        def disturb(progress) -> None:
            if progress.generation == 1:
                running.kill("worker-0")
            if progress.generation == 2:
                running.kill("worker-1")  # nobody is left, and one comes while the tuning waits
                threading.Timer(3.0, running.add).start()

        with pytest.warns(match="no worker is left at tcp://127.0.0.1:.*: waiting for a worker"):
            asked = {"validation": folders[3:], "out": tmp_path / "out", "progress": disturb}
            tune(folders[:3], cluster=client, **asked, **SMALL)
        assert file_contents(tmp_path / "out") == on_threads

        # With the scheduler gone it ends in one line, and goes on elsewhere.
        def end(progress) -> None:
            if progress.generation == 2:
                running.kill("scheduler")

        began = time.monotonic()
        with pytest.raises(
            ClusterError, match=r"^the scheduler at tcp://.* no longer answers; .* continue with --resume"
        ) as caught:
            tune(
                folders[:3],
                validation=folders[3:],
                out=tmp_path / "two",
                progress=end,
                cluster=client,
                **SMALL,
            )
        assert "\n" not in str(caught.value)
        assert time.monotonic() - began < 60
    drives = [read_drive(folder) for folder in folders]
    tune(drives[:3], validation=drives[3:], out=tmp_path / "two", resume=True, **SMALL)
    assert file_contents(tmp_path / "two") == on_threads


def test_a_newcomer_takes_its_share(processes, client, folders):
    (dataset,), _ = remote_datasets(Cluster(client), [folders])
    replays = make_scorer(dataset, PassOptions(), partial(require_fit, objective="truth-rmse", seed=0))
    before = replays.scores([FILTER]).position_rmse
    name = processes.add()
    try:
        client.wait_for_workers(3, timeout=60)
        dataset.assignment._polled = -np.inf
        assert (replays.scores([FILTER]).position_rmse == before).all()
        drives = Counter(dataset.assignment.owners)
        assert set(drives) == set(dataset.assignment.workers)
        assert sorted(drives.values()) == [1, 1, 2]
        while client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)):
            time.sleep(0.05)  # a scheduler warns of results that are lost with a worker
    finally:
        processes.kill(name)


@pytest.mark.long
def test_a_study_asks_the_workers_for_what_it_asks_here(client):
    config = StudyConfig(maneuvers=("turns", "brake"), environments=("clear",), runs=2, trials=2)
    here, there = make_design(config), make_design(config, cluster=client)
    assert (here.conditions, here.strata) == (there.conditions, there.strata)
    assert here.fingerprint() == there.fingerprint()
    assert [here.split(k) for k in range(2)] == [there.split(k) for k in range(2)]
    a, b = score_all(here, {}), score_all(there, {})
    assert a.to_frame().equals(b.to_frame())


def test_compare_and_simulate_are_those_of_threads(client, folders):
    drives = [read_drive(folder) for folder in folders]
    few = {"particles": 4, "generations": 2, "model": "planar5", "optimizers": ("de", "pso"), "seeds": 1}
    here = compare(drives[:2], validation=drives[2:], **few)
    there = compare(folders[:2], validation=folders[2:], cluster=client, **few)
    assert here.runs_frame.equals(there.runs_frame)
    made = list(simulated_on(client, ["turns"], ["clear"], 2, gps="white-1m"))
    for one, other in zip(made, drives, strict=False):
        assert_same(one, other)


@pytest.mark.filterwarnings("ignore:Cyclopts application")
def test_the_command_tells_a_cluster_that_is_not_there_in_one_line(folders, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sigmaswarm.datasets.cluster.CONNECT_TIMEOUT", 1.0)
    there = ["--out", str(tmp_path / "out"), "--cluster", "tcp://127.0.0.1:1"]
    monkeypatch.setattr("sys.argv", ["sigmaswarm", "tune", str(folders[0]), *there])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("sigmaswarm: --cluster tcp://127.0.0.1:1: no scheduler answers at this address")


def test_all_drives_that_cannot_be_read_are_named_first(client, folders, tmp_path):
    broken = write_drive(read_drive(folders[0]), tmp_path / "broken")
    (broken / "gps.csv").write_text("t,x,y\n1,2\n")
    with pytest.raises(InputError) as caught:
        tune([folders[0], broken, tmp_path / "missing"], out=tmp_path / "out", cluster=client, **SMALL)
    said = str(caught.value)
    assert said.startswith("2 drives can't be used: (1) ")
    assert f"{broken}/gps.csv, row 2: '1,2' has 2 cells, but the header has 3" in said
    assert f"{tmp_path}/missing does not exist" in said
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


def test_a_worker_drops_what_was_used_last_and_reads_it_again(folders):
    sources = {str(k): source_of(folder) for k, folder in enumerate(folders)}
    one = CachedDrive(read_drive(folders[0]), []).size
    cache = DriveCache("tcp://here:1", 1, 3.5 * one)
    keys = dict.fromkeys(sources)
    assert cache.get(keys) is None
    first = cache.get({k: sources[k] for k in "012"})
    assert cache.get(dict.fromkeys("12")) == first[1:]
    assert cache.get({"3": sources["3"]})
    assert cache.get({"0": None}) is None  # the oldest
    assert cache.get({"1": None, "3": None})[0] is first[1]
    with pytest.raises(ClusterError, match=r"here:1: its 4 drives need about .* GB of memory, but it has"):
        cache.get(sources)


def test_160_drives_of_ten_minutes_fit_two_workers_of_4_gb():
    long = 10 * CachedDrive(simulate("urban", duration=60.0), []).size
    assert BASE_MEMORY + 80 * long < USABLE_MEMORY * 4e9  # 23 MB each were measured


def test_drives_are_shared_by_size_and_threads_and_few_move():
    sizes = [3.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    two = assign_drives(sizes, {"a": 1, "b": 1}, [""] * 6)
    load = [sum(s for s, w in zip(sizes, two, strict=True) if w == name) for name in "ab"]
    assert load == [4.0, 4.0]
    assert assign_drives(sizes, {"a": 1, "b": 1}, two) == two
    without = assign_drives(sizes, {"b": 1}, two)
    assert without == ["b"] * 6
    three = assign_drives([1.0] * 8, {"a": 1, "b": 1, "c": 2}, ["a", "b"] * 4)
    assert Counter(three) == {"a": 2, "b": 2, "c": 4}
    assert sum(now != before for now, before in zip(three, ["a", "b"] * 4, strict=True)) == 4


def test_a_worker_with_another_version_is_refused(processes, folders):
    name = processes.add(OTHER_VERSION)
    try:
        with connected(str(processes.file)) as client:
            client.wait_for_workers(3, timeout=60)
            with pytest.raises(
                ClusterError, match=r"^worker tcp://127.*: has sigmaswarm 0\.0\.1, but this machine has "
            ):
                tune(folders, cluster=client, **SMALL)
    finally:
        processes.kill(name)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://127.0.0.1:1", "no scheduler answers at this address"),
        ("tcp://127.0.0.1", "is not an address like tcp://host:8786"),
        ("tls://127.0.0.1:8786", "create a Client in Python"),
        ("nowhere.json", "is not an existing scheduler file; specify one, or write an address like"),
        ("local:none", "specify the number of processes, for example local:4"),
    ],
)
def test_an_address_that_is_none_is_one_line(address, said, monkeypatch):
    monkeypatch.setattr("sigmaswarm.datasets.cluster.CONNECT_TIMEOUT", 1.0)
    with pytest.raises((InputError, ClusterError)) as caught, connected(address):
        pass
    assert str(caught.value).startswith(f"--cluster {address}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scheduler_file_that_is_none_is_one_line(tmp_path: Path):
    file = tmp_path / "scheduler.json"
    for content in ("{}", "no json", "[1]"):
        file.write_text(content)
        with pytest.raises(InputError, match="is not a scheduler file"), connected(str(file)):
            pass


def test_workers_that_all_go_at_once_are_waited_for():
    """By a scheduler that takes them away: as many as there are is no reason to end."""

    class Gone(Exception):
        pass

    class Scheduler:
        address, answers = "tcp://here:1", iter([{f"tcp://worker:{k}": 1 for k in range(20)}, {}])

        def workers(self):
            if (found := next(self.answers, None)) is None:
                raise Gone
            return found

        def version_errors(self, addresses):
            return {}

    assignment = Assignment(Scheduler(), [])
    assignment.poll()
    with pytest.raises(Gone), pytest.warns(match="no worker is left at tcp://here:1: waiting"):
        assignment.poll()


def test_a_path_goes_out_whole(folders, monkeypatch):
    monkeypatch.chdir(folders[0].parent)
    source = source_of(folders[0].name)
    monkeypatch.chdir("/")
    assert source()[0].name == read_drive(folders[0]).name


def test_a_cluster_and_an_executor_are_too_many(client, folders):
    from concurrent.futures import ThreadPoolExecutor

    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(InputError, match="executor and cluster can't be combined"),
    ):
        tune(folders, cluster=client, executor=pool, **SMALL)


def test_nothing_was_warned_of(processes):
    assert "WARNING" not in processes.log()
    assert "Traceback" not in processes.log()


def test_what_workers_cannot_import_is_one_line(client, folders):
    (dataset,), _ = remote_datasets(Cluster(client), [folders[:1]])
    with pytest.raises(ClusterError, match=r"^worker tcp://.* can't run the task .*ModuleNotFoundError"):
        dataset.map(test_nothing_was_warned_of)  # of a module that no worker has
