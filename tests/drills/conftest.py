"""Drills fork, kill and fill disks: they run where Python can do that."""

import os

collect_ignore_glob = [] if hasattr(os, "fork") else ["*"]
