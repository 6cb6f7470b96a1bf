// written by docs/generate.py from the class codes; do not edit
viewer.setClassifications({
    0: {visible: true, name: "never classified", color: [0.706, 0.706, 0.706, 1]},
    1: {visible: true, name: "unclassified", color: [0.706, 0.706, 0.706, 1]},
    2: {visible: true, name: "ground", color: [0.561, 0.271, 0.071, 1]},
    5: {visible: true, name: "vegetation", color: [0.165, 0.616, 0.408, 1]},
    6: {visible: true, name: "building", color: [0.961, 0.314, 0.118, 1]},
    7: {visible: true, name: "noise", color: [0.149, 0.149, 0.149, 1]},
    18: {visible: true, name: "high noise", color: [0.149, 0.149, 0.149, 1]},
    64: {visible: true, name: "stem", color: [0.910, 0.769, 0.094, 1]},
    65: {visible: true, name: "car", color: [0.165, 0.298, 0.761, 1]},
    66: {visible: true, name: "curb", color: [0.988, 0.898, 0.133, 1]},
    67: {visible: true, name: "vertical", color: [0.969, 0.275, 0.075, 1]},
    68: {visible: true, name: "horizontal", color: [0.678, 0.894, 0.733, 1]},
    69: {visible: true, name: "pole", color: [0.651, 0.435, 0.816, 1]},
    DEFAULT: {visible: true, name: "other", color: [0.5, 0.5, 0.5, 1]},
});
