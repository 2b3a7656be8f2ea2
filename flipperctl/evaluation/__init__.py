"""Evaluation: any policy on any scene; typed results, statistics, files, audits of rewards."""
