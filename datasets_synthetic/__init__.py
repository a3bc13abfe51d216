"""Captures whose truth is exact: identities, performances, rigs, rendered views."""
