"""The prose of the page of `crowdbench validity`."""

from crowdbench.study.validity import door
from crowdbench.study.validity.measure import LAST, LENGTH, STUCK, TIME, WIDTH

LIMITS = {
    "orca": """\
ORCA keeps people from colliding, and knows no other wish for distance. Those with the same
preferred speed do not slow down until they are packed so tightly that they can hardly start, and those with different
speeds slow down much less than people do. In two directions they form lanes where there is room, and otherwise a jam,
which nobody has seen with people. Those of radius 0.2 m go through a door about as fast as people do; those of radius
0.3 m hold each other up before a door through which only one fits at a time.""",
    "social_force": """\
Its people keep too much distance. The repulsion has the strength of the paper (Helbing and
Molnár 1995), but where the paper has the distance between the centres of two people, here it is that between their
rims, and what pushes from behind counts half. In a dense crowd people are therefore pushed back more than they want to
go on, and walk backwards; points, as in the paper, slow down as people do, or more. In two directions no lanes form,
not even of points. Walls repel too, so that few get through a narrow door.""",
}
"""What the policies that ship can and cannot do, each after its name."""

INTRODUCTION = """\
Printed by `crowdbench validity`: what crowds do that a pedestrian policy moves, beside what is published about people.
`crowdbench validity ./mine.py` measures a policy of your own.

Each figure is a mean over {worlds} worlds, which differ in their random numbers alone, with its 95 % interval
(Student's t). Policies have their default parameters, a step takes 0.25 s, and there is no vehicle. Three kinds of
people walk:

- of radius 0.3 m, with a preferred speed of 1 m/s: as in most scenarios. More than 2.5 of them on a square metre hardly
  fit,
- of radius 0.2 m, with preferred speeds of 1.34 m/s on average (standard deviation 0.26 m/s, within two of them), as
  measured (Weidmann 1993). As many of them fit on a square metre as in experiments,
- the same, but of radius 0.01 m, in the corridor alone: almost points, as in the paper on the social force model
  (Helbing and Molnár 1995)."""

ONE_WAY = f"""\
All walk in the same direction in a corridor of {LENGTH:g} m x {WIDTH:g} m, whose end is its beginning: who leaves it on
one side enters it on the other, and sees those behind the seam as all others. They start at rest, in random places of a
grid. Shown is their mean speed in the direction in which they want to go, in the last {LAST:g} of {TIME:g} s; it is
negative where they walk backwards. Overlapping are those whose disc overlaps another by more than 1 cm at the end.
Published is Weidmann's curve (Weidmann 1993), a fit to many data sets, scaled to the preferred speed."""

SINGLE_FILE = """\
In single file, everybody is held in the middle of the corridor. Published is the linear relation of Seyfried et al.
(2005), by which people at speed v need 0.36 m + 1.06 s v."""

TWO_WAYS = f"""\
The same corridor, where half of the people, drawn by chance, walk in the other direction. The order parameter of lane
formation (Rex and Löwen 2007), reduced as by Nowak and Schadschneider (2012), is 100 % where every lane has one
direction, and on average 0 where directions are mixed, as they are at the start. Stuck are worlds in which people walk
on average at less than {100 * STUCK:g} % of their preferred speed. There is no published figure for this corridor. In
experiments people form lanes, their speed by density is that of one direction up to about 1 person/m² and their largest
flow is smaller, and the jams of many models have never been observed, there or in the field (Zhang et al. 2012)."""

DOOR = f"""\
{door.NUMBER} people in a hall of {door.HALL:g} m width walk through a door in a thin wall, which is {door.BEFORE:g} m
from the first of them. The specific flow is the number of people per second and metre of the door's width, from the
first of them to the last, or to the end of {door.TIME:g} s where not all get through. A door is blocked where people
wait, and nobody has passed it in the last {door.STILL:g} s. Published are the flows of as many people through a
bottleneck of 2.8 m length (Seyfried et al. 2009, table 2). Others have found that the specific flow does not depend on
the width where more than one person can pass at a time (Kretz et al. 2006); for design, 1.3 /(m s) of a width without
0.15 m on either side is usual (Gwynne and Rosenbaum 2016)."""
