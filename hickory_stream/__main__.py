"""`python -m hickory_stream` is `hickory-stream`."""

import sys

from hickory_stream.cli import main

if __name__ == "__main__":
    sys.exit(main())
