"""What a reader of WebDataset finds in shards, by plain libraries."""

from pathlib import Path
import tarfile


def read_shards(folder: Path) -> list[tuple[str, dict[str, bytes]]]:
    """Return key and files of each sample as a reader of WebDataset groups them: by neighbours."""
    found: list[tuple[str, dict[str, bytes]]] = []
    for path in sorted(folder.glob('*.tar')):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, extension = member.name.partition('.')
                if not found or found[-1][0] != key:
                    found.append((key, {}))
                assert extension not in found[-1][1]
                stream = tar.extractfile(member)
                assert stream is not None
                found[-1][1][extension] = stream.read()
    return found
