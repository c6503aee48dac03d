"""Print the README's first or second set-up command: the only place that holds them is the README."""

import re
import sys
from pathlib import Path


def main() -> None:
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"```sh setup\n(.+?)\n```", readme)
    if len(commands) != 2 or any("\n" in command for command in commands):
        sys.exit(f"README.md: {len(commands)} set-up commands; expected two blocks ```sh setup of one line each")
    print(commands[int(sys.argv[1]) - 1])


if __name__ == "__main__":
    main()
