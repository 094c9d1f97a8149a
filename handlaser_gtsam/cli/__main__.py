"""python -m handlaser_gtsam.cli, for machines whose PATH lacks the command."""

from . import main

main()
