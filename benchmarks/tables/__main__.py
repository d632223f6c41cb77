"""Write the tables into the documents, or say which of them differ."""

import argparse
import sys

from benchmarks.tables.catalogue import TABLES
from benchmarks.tables.page import documents, filled


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail on differences")
    check = parser.parse_args().check
    differ = []
    for path in documents():
        text = path.read_text(encoding="utf-8")
        new = filled(text, TABLES, path.name)
        if new != text:
            differ.append(path.name)
            if not check:
                path.write_text(new, encoding="utf-8")
    if check and differ:
        sys.exit(f"tables differ from their result files in {', '.join(differ)}; run make tables")
    print(f"{len(TABLES)} tables; {'written' if differ else 'nothing to write'}: {differ}")


if __name__ == "__main__":
    main()
