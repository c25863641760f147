"""The laboratory of strange laws: errors of sensors outside the catalogue.

They are written without a look at what a search can express, each from a thing that could
be the matter with a device. `still`, `memory`, `over_time`, `others`, `beyond` and `yet_more`
hold responses; `gyro`, `accel`, `compass`, `more`, `third` and `fourth` say which of them a
sensor has to what, and why; `known` what catalogued physics could make of such an error;
`device` puts it into a world. It grows with every miss.
"""
