"""Pages of the rig over the internet, by a relay that a lab runs itself. `server` is the relay, `client` its rig."""
