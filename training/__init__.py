"""Learning on twc_env: one readable file per algorithm. Run `twc-env train --help`."""

import twc_env  # noqa: F401  first: handles Ctrl-C during other imports
