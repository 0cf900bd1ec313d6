"""The replay gate: recorded hands through the whole chain, compared with stored desired tools, commands and goals."""
