"""Packets of spinning scanners, from captures of a network: Velodyne, Ouster, Hesai."""

from prc_cli.formats.registry import Format

FORMATS = (
    Format(
        name="capture",
        scans=(".pcap", ".pcapng"),
        images="prc_cli.formats.packets.read:PacketStream",
    ),
)
