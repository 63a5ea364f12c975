"""Placers side by side: what becomes of what they propose, as figures and tables."""
