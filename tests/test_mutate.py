"""What tools/mutate.py keeps of a session of cosmic-ray, and what it says of the results. No fault is tried here."""

from __future__ import annotations

import sqlite3

import pytest

from tools import mutate


@pytest.fixture
def session(tmp_path):
    """Two lines with three faults each, of which one is of an operator that is not used."""
    file = tmp_path / "session.sqlite"
    with sqlite3.connect(file) as database:
        database.execute("CREATE TABLE mutation_specs (job_id, operator_name, module_path, start_pos_row)")
        database.execute("CREATE TABLE work_items (job_id)")
        database.execute("CREATE TABLE work_results (job_id, test_outcome, worker_outcome, diff)")
        for line in (3, 7):
            for operator in ("NumberReplacer", "AddNot", "ReplaceBinaryOperator_Add_BitOr"):
                job = f"{line} {operator}"
                values = (job, f"core/{operator}", "src/modules/kst/src/kst/a.py", line)
                database.execute("INSERT INTO mutation_specs VALUES (?, ?, ?, ?)", values)
                database.execute("INSERT INTO work_items VALUES (?)", (job,))
    return file


@pytest.mark.parametrize(("count", "lines"), [(1, 1), (2, 2), (50, 2)])
def test_one_fault_of_a_line_is_kept(session, count, lines):
    mutate.keep_some(session, count, 0)
    with sqlite3.connect(session) as database:
        jobs = [job for (job,) in database.execute("SELECT job_id FROM work_items")]
        assert jobs == [job for (job,) in database.execute("SELECT job_id FROM mutation_specs")]
    assert len(jobs) == len({job.split()[0] for job in jobs}) == lines
    assert not any("BitOr" in job for job in jobs)


def test_the_report_names_the_faults_that_no_test_found(session):
    mutate.keep_some(session, 2, 0)
    with sqlite3.connect(session) as database:
        first, other = (job for (job,) in database.execute("SELECT job_id FROM work_items ORDER BY job_id"))
        diff = "--- a\n+++ b\n x\n-    a = 1\n+    a = 2\n"
        results = [(first, "SURVIVED", "NORMAL", diff), (other, "KILLED", "NORMAL", diff)]
        database.executemany("INSERT INTO work_results VALUES (?, ?, ?, ?)", results)
    assert mutate.report(session).splitlines() == [
        "src/modules/kst/src/kst/a.py:3", "    -    a = 1", "    +    a = 2",
        "kst                  1 of   2 found", "1 of 2 faults found",
    ]  # fmt: skip
