"""Evaluation: results of any policy on any scene, statistics, files and reward audits."""
