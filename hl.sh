#!/bin/bash
exec /tmp/venv/bin/python -c "import sys; sys.path.insert(0,'/tmp/edit'); sys.argv[0]='handlaser'; from handlaser_gtsam.cli import main; main()" "$@"
