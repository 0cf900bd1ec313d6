"""Bad networks on real TCP: a program delays, loses, reorders, repeats or holds the packets of connections."""
