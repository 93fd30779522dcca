"""Commands of the command line, one file each; `rx90b_flex.cli` puts them together."""
