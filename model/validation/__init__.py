"""Validation before accepting: does every joint move as it should?"""
