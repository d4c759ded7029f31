"""Write reference results anew: `python test/references/write.py [CASE …]`, all by default.

A case is `room/name`, or `room` for all of it. The values that change are printed.
"""

from __future__ import annotations

from pathlib import Path
import sys
import tempfile


def main() -> None:
    """Write those that are named, or all, and forget cases that are no more."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from references.cases import all_cases, FOLDER, found, ROOMS, stored
    from references.summary import difference, text_of
    cases, wanted = all_cases(), sys.argv[1:]
    for name in wanted:
        if not any(name in (case, case.partition('/')[0]) for case in cases):
            sys.exit(f'{name}: there is no such case')
    for room in ROOMS:
        before, after = stored(room), {}
        for case in cases:
            name = case.removeprefix(f'{room}/')
            if name == case:
                continue
            if wanted and case not in wanted and room not in wanted:
                if name in before:
                    after[name] = before[name]
                continue
            with tempfile.TemporaryDirectory() as folder:
                after[name] = found(case, Path(folder))
            if name not in before:
                print(f'{case}: new')
            elif text := difference(before[name], after[name], case):
                print(text)
        path = FOLDER / 'stored' / f'{room}.json'
        path.parent.mkdir(exist_ok=True)
        path.write_text(text_of(after), encoding='utf-8')


if __name__ == '__main__':
    main()
