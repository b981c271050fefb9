"""The source paper, regenerated: tables and figures of doc/paper.md, a module for each kind."""
