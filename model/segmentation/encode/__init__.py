"""Encode an asset once: nodes, their graph, superpoints, merge trees and random walks."""
