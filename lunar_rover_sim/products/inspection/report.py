"""The outcome of the checks: one line per check, and whether the bag can be trusted."""

from __future__ import annotations

import dataclasses
import enum


class Status(enum.Enum):
    """Outcome of one check; a single FAIL means that the bag cannot be trusted."""

    PASS = 'pass'
    WARN = 'warn'
    FAIL = 'fail'
    SKIP = 'skip'


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line of the report: name of the check, outcome, and the numbers behind it."""

    check: str
    status: Status
    detail: str


@dataclasses.dataclass
class CheckReport:
    """All findings on one bag."""

    findings: list[Finding] = dataclasses.field(default_factory=list)
    prefix: str = ''

    def of(self, prefix: str) -> CheckReport:
        """Return a report whose findings are added to this one, their names prefixed."""
        return CheckReport(self.findings, prefix)

    def add(self, check: str, status: Status, detail: str) -> None:
        """Append a finding."""
        self.findings.append(Finding(self.prefix + check, status, detail))

    def verdict(self, check: str, problems: list[str], fine: str,
                bad: Status = Status.FAIL) -> None:
        """Append a finding that passes without problems, and names the first three otherwise."""
        if not problems:
            self.add(check, Status.PASS, fine)
            return
        more = f' (and {len(problems) - 3} more)' if len(problems) > 3 else ''
        self.add(check, bad, '; '.join(problems[:3]) + more)

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.failed

    @property
    def failed(self) -> list[Finding]:
        """The findings with the outcome FAIL."""
        return [f for f in self.findings if f.status is Status.FAIL]


def grouped(problems: dict[str, str]) -> list[str]:
    """Return one text per problem, with the topics that share it."""
    names: dict[str, list[str]] = {}
    for name, problem in problems.items():
        names.setdefault(problem, []).append(name)
    return [shared[0] + (f' and {len(shared) - 1} more' if len(shared) > 1 else '')
            + f': {problem}' for problem, shared in names.items()]
