"""The table of checks: what each asks, its limit, why the limit is that number, and what it cannot see."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Check:
    """A question that is asked of every input."""

    name: str
    """Name, as for ``--accept-doubt``."""
    asks: str
    """The question."""
    limit: str
    """Where doubt begins, and where the input is refused."""
    reason: str
    """Why the limit is that number."""
    blind: str
    """What the check cannot see."""


INPUT_CHECKS: tuple[Check, ...] = (
    Check(
        "thinned",
        "Does the file's own run record say that shots were left out?",
        "Doubtful wherever it does (`prc thin`)",
        "Classes follow from the neighbours of a shot: without those that were dropped they are others",
        "Files that lost their record, or that other programs thinned.",
    ),
    Check(
        "ranges",
        "Are the ranges numbers that a scanner can measure?",
        "Refused where the median range is below 0.02 m or above 5 km, or more than 20 % of the ranges lie beyond 20 "
        "km; doubtful above 150 m, and from 1 % on, and where a range of the first lines is below 0.1 mm or above 1000 "
        "km: a header read as shots",
        "No scanner on a vehicle measures either. Floats of the wrong byte order, a shift of two bytes and integers "
        "read as floats spread over all powers of ten",
        "Numbers of the right size.",
    ),
    Check(
        "rounding",
        "Are the ranges finer than the thresholds of the methods?",
        "Doubtful where all ranges are multiples of more than 0.03 m",
        "Scanners state ranges to 1 to 10 mm. Rounded to 0.1 m, a wall is a stair",
        "Rounding of angles, and coordinates that were rounded before ranges were computed from them.",
    ),
    Check(
        "missing-code",
        "Does the largest of all ranges stand for no return?",
        "Doubtful where more than 1 % of the ranges are equal to the largest, and that is twice the median of the "
        "others",
        "Two ranges of a scan are equal by chance; a thousand are a code",
        "Codes that are not the largest range, such as 0 and NaN, which count as missing anyway.",
    ),
    Check(
        "shot-order",
        "Do consecutive shots see the same surfaces?",
        "The median step of the range from shot to shot, as a share of that of random shots: doubtful from 0.3, "
        "refused from 0.7. Refused where every second shot is more alike than the next",
        "At most 0.05 in 23 scans of streets, forests, static scans and a 64-ring frame; 1 where shots are shuffled",
        "Shots sorted by coordinate: they are alike, in another order.",
    ),
    Check(
        "line-length",
        "Do lines repeat after M shots, and not after another number?",
        "Refused where the ranges repeat after another number (a part of M, a multiple, or any other), where the line "
        "after next is twice as alike as the next, or where M less or more by up to four agrees 1.2 times better along "
        "the stream; doubtful from 1.05",
        "Rightly told at most 0.9, with M off by one 1.16 to 7: what moves with the scanner, its dead angle and the "
        "ground, keeps its columns only with the right M",
        "Streams of fewer than 16 true lines; M off by a few in fewer than 24 lines, or in fewer lines than a twelfth "
        "of M where it agrees less than 1.25 times better.",
    ),
    Check(
        "columns-along",
        "Do all columns keep their place along the stream?",
        "Where, from one place to the next, a shift of all columns by 3 % of a line or more leaves less than 0.65 of "
        "the difference: doubtful; less than 0.45: refused",
        "Rightly told at least 0.8; 0.07 to 0.55 where a third of a line was lost, and 0.86 in a static scan of a park",
        "Losses of less than 3 % of a line, and of whole lines.",
    ),
    Check(
        "line-order",
        "Does the scene change along the stream, but little from line to line?",
        "Doubtful where lines far apart differ less than 1.6 times as much as neighbours, in the tenth that changes "
        "most; refused below 1.4 times",
        "Rightly told at least 2.1, but 1.57 in a walk of 50 lines; with shuffled lines 0.8 to 1.2",
        "A few large parts out of place, in a stream without times.",
    ),
    Check(
        "standing",
        "Does the platform move?",
        "Doubtful where, in 200 lines or more, lines far apart differ as neighbours do, both no more than noise; or "
        "where the next line sees 85 % of the leaves and edges again",
        "A standing scanner sees the same line again and again; methods that compare lines then take noise for shape",
        "A stop that is shorter than most of the stream.",
    ),
    Check(
        "repeated-lines",
        "Do lines come twice, shot by shot?",
        "Doubtful from 8 lines on",
        "Ranges carry noise: in real scans no line is equal to another",
        "Lines of fewer than 32 shots.",
    ),
    Check(
        "times",
        "Do the times rise from record to record?",
        "Refused where more than 1 in 10,000 steps go back, or one goes back by more than 5,000 shots or a tenth of "
        "the whole time",
        "Threads of a writer swap neighbouring records; a block out of place is a long step back, but a rare one",
        "Times that were made up from the order of the records.",
    ),
    Check(
        "collisions",
        "Has every shot a cell of its own?",
        "Doubtful above 1 % of the records (5 % in frames of rings), refused above 20 %",
        "Rounded times and angles bring two shots into a cell now and then; two scanners do it all the time",
        "Records that overwrite nothing because their cells lie elsewhere.",
    ),
    Check(
        "unplaced",
        "Has every record a cell?",
        "Doubtful above 1 % of the records, refused above 20 %",
        "Records without a cell stay unclassified",
        "Records in the wrong cell.",
    ),
    Check(
        "left-out",
        "Where columns are by order: do lines hold all their shots?",
        "Doubtful where lines lack more than 1 % of the shots of the longest",
        "A shot that is left out moves the rest of its line up, so that neighbouring lines no longer match",
        "Lines that all lack as many shots.",
    ),
    Check(
        "returns",
        "Have shots a range?",
        "Doubtful below 2 % of the shots",
        "Where lines or columns are wrong nearly all cells are empty; an open sky leaves a third to two thirds",
        "Which shots are missing.",
    ),
    Check(
        "other-readers",
        "LAS, LAZ: does laspy read the header and its VLRs?",
        "Doubtful where it refuses them",
        "They are copied byte for byte: who reads labels with laspy could not open the output",
        "Damage that laspy reads, and what other libraries refuse.",
    ),
    Check(
        "method",
        "Was the method taken that labels such inputs best?",
        "Doubtful where PRC as published was taken because the angles of the beams are neither told nor to be measured",
        "On simulated streets of photon-80 the mean F1 of PRC is 0.59, that of fused 0.96",
        "Nothing where the method is named: that is the user's choice.",
    ),
    Check(
        "range-noise",
        "Is the noise of the ranges one that the method stands?",
        "PRC and fused in forests: doubtful above 12 mm, as the twentieth of the shots that lie nearest to the "
        "middle of "
        "their neighbours tells it",
        "Forest scanners give 2 to 3 mm by this figure; noise of 1 cm gives 20 mm or more, because few surfaces in a "
        "forest are smooth",
        "Streets: their methods stand 3 cm.",
    ),
    Check(
        "dropouts",
        "Are shots lost amid smooth surfaces?",
        "Doubtful above 8.5 % of the shots between two equal ranges on either side",
        "At most 6 % in all scans at hand. Isolated gaps cost classes at their edges",
        "Lost lines, and losses at edges and in leaves.",
    ),
)
"""Checks of the ranges and the counts of the reader; see also the tables beside the other checks."""
