#!/usr/bin/env python3
"""Pages of the rig over the internet, by a relay that a lab runs itself."""

from leap_rig.relay.command_line import main

if __name__ == "__main__":
    main()
