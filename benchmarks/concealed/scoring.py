"""Scoring."""


def score(places, results):
    return ""
