"""Packets of spinning scanners, from captures of a network: Velodyne, Ouster, Hesai."""
