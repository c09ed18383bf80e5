"""Charts of pipelines/accuracy, by gnuplot, as SVG and PNG: draw_all(table, folder).

Places are in pixels of the whole picture, from its upper left corner: so a chart knows where its own points lie, and puts
each name beside what it names, over nothing else.
"""
import math
import re
import subprocess
import sys

from accuracy_table import (DEFAULT, GRADIENTS, HOLLOW_PPM, LEAST, SOLVES, auto_of, cost_column, default_of, floors, key_of, median, methods_of, number,
                            over_all_fields, pareto, peers_of)

COLOURS = {"midpoint": "#777777", "linear": "#c98500", "repeated": "#d55e00", "marmitt": "#0072b2", "analytic": "#b8578c", "robust": "#008a60"}
PEER_STYLES = {"mc-embree": ("Embree", "#8c510a", 5), "mc-raster": ("OpenGL", "#01665e", 13), "opencl": ("OpenCL", "#762a83", 15)}
FIELD_COLOUR, PIXEL_COLOUR = "#aa0000", "#0000aa"
ERRORS = (LEAST / 3, 3000)  # the axis of the Pareto charts
WORST_ERRORS = (1e-10, 3000)  # and of the overview


def gnuplot(script):
    done = subprocess.run(["gnuplot"], input=script, text=True, capture_output=True)
    if done.returncode != 0:
        sys.exit("accuracy_report: gnuplot: " + done.stderr.strip())


def both_formats(folder, name, width, height, body):
    """Letters in the body are measured in pixels, marks as in a PNG. In a PNG letters are measured in points, of which 3 make 4 pixels, and marks are larger in an SVG."""
    in_points = re.sub(r"font ',(\d+)'", lambda m: f"font ',{0.75 * int(m[1]):.2f}'", body)
    body = re.sub(r" ps ([\d.]+)", lambda m: f" ps {0.72 * float(m[1]):.2f}", body)
    gnuplot(f"set terminal svg size {width},{height} dynamic font 'sans,12' background '#ffffff'\nset output '{folder}/{name}.svg'\n{body}")
    gnuplot(f"set terminal pngcairo size {width},{height} font 'sans,9' background '#ffffff'\nset output '{folder}/{name}.png'\n{in_points}")


def axis_tics(low, high, count=4):
    """Round numbers between two, evenly on a logarithmic axis."""
    return ", ".join(dict.fromkeys(f"{low * (high / low) ** (i / (count - 1)):.3g}" for i in range(count)))


class Panel:
    """One plot with logarithmic axes in a picture of `size` pixels; `box`: left, top, right and bottom of its frame."""

    def __init__(self, name, size, box, x, y):
        self.name, self.size, self.box, self.x, self.y = name, size, box, x, y
        self.data, self.plots, self.settings = "", [], ""
        self.taken = []  # what labels must not cover: left, top, right, bottom, how bad that is

    def place(self, x, y):
        def part(value, axis):
            return (math.log(value) - math.log(axis[0])) / (math.log(axis[1]) - math.log(axis[0]))
        left, top, right, bottom = self.box
        return left + (right - left) * part(x, self.x), bottom - (bottom - top) * part(y, self.y)

    def take(self, x, y, radius, weight=1.0):
        self.taken.append((x - radius, y - radius, x + radius, y + radius, weight))

    def add(self, rows, style):
        block = f"{self.name}_{len(self.plots)}"
        self.data += f"${block} << EOD\n" + "".join(" ".join(str(v) for v in row) + "\n" for row in rows) + "EOD\n"
        self.plots.append(f"${block} {style}")

    def mark(self, x, y, style, size, colour):
        self.add([(x, y)], f"using 1:2 with points pt {style} ps {size:.2f} lc rgb '{colour}'")
        self.take(*self.place(x, y), 2 + 3.5 * size)

    def line(self, points, style):
        self.add(points, f"using 1:2 with {style}")
        places = [self.place(*p) for p in points]
        for (x0, y0), (x1, y1) in zip(places, places[1:]):
            steps = 1 + int(math.hypot(x1 - x0, y1 - y0) / 6)
            for i in range(steps + 1):
                self.take(x0 + (x1 - x0) * i / steps, y0 + (y1 - y0) * i / steps, 1.5, 0.4)

    def level(self, y, colour, words, above=True):
        """A line across, with words at its right end."""
        self.line([(self.x[0], y), (self.x[1], y)], f"lines dt 3 lc rgb '{colour}'")
        if words:
            self.text(words, self.box[2] - 4, self.place(self.x[0], y)[1] + (-7 if above else 7), colour, 9, "right")

    def text(self, words, x, y, colour, font, align):
        width, height = self.size
        self.settings += f"set label {self.quoted(words)} at screen {x / width:.5f},{1 - y / height:.5f} {align} font ',{font}' tc rgb '{colour}' front\n"
        left = x - {"left": 0, "center": 0.5, "right": 1}[align] * self.length(words, font)
        self.taken.append((left, y - 0.6 * font, left + self.length(words, font), y + 0.6 * font, 1.0))

    @staticmethod
    def quoted(words):
        return '"' + words.replace('"', "") + '" noenhanced'

    @staticmethod
    def length(words, font):
        return 0.58 * font * len(words)

    def badness(self, box, taken):
        left, top, right, bottom = box
        outside = max(0, self.box[0] + 2 - left) + max(0, right - self.box[2] + 2) + max(0, self.box[1] + 2 - top) + max(0, bottom - self.box[3] + 2)
        return 100 * outside + sum(w * (min(right, r) - max(left, l)) * (min(bottom, b) - max(top, t)) for l, t, r, b, w in taken if l < right and left < r and t < bottom and top < b)

    def label(self, words, x, y, colour, font=11, away=6):
        """Words beside a point, where they cover least; a thin line leads to them when they are far."""
        px, py = self.place(x, y)
        width, height = self.length(words, font), 1.2 * font
        best, reach = None, away + 66 + width
        near = [box for box in self.taken if box[0] < px + reach and box[2] > px - reach and box[1] < py + reach and box[3] > py - reach]
        for distance in (away, away + 6, away + 14, away + 24, away + 36, away + 50, away + 66):
            if best and best[0] < 0.8 * (distance - away):
                break
            for angle in (0, 180, 45, 315, 90, 270, 135, 225):
                dx, dy = math.cos(math.radians(angle)), -math.sin(math.radians(angle))
                left = px + distance * dx + (width / 2) * (dx - 1) if abs(dx) < 0.99 else (px + distance if dx > 0 else px - distance - width)
                left = min(max(left, self.box[0] + 3), self.box[2] - 3 - width)
                top = py + distance * dy + (height / 2) * (dy - 1)
                cost = self.badness((left, top, left + width, top + height), near) + 0.8 * (distance - away) + (0 if angle % 180 == 0 else 3)
                if best is None or cost < best[0]:
                    best = (cost, distance, left, top)
        _, distance, left, top = best
        if distance > away + 8:
            near_x, near_y = min(max(px, left), left + width), min(max(py, top), top + height)
            w, h = self.size
            self.settings += f"set arrow from screen {px / w:.5f},{1 - py / h:.5f} to screen {near_x / w:.5f},{1 - near_y / h:.5f} nohead lw 0.5 lc rgb '{colour}' front\n"
        self.text(words, left, top + height / 2, colour, font, "left")

    def script(self, title="", x_label="", y_label="", x_tics="", y_tics=True):
        w, h = self.size
        left, top, right, bottom = self.box
        return (f"unset label\nunset arrow\nset lmargin at screen {left / w:.5f}\nset rmargin at screen {right / w:.5f}\nset tmargin at screen {1 - top / h:.5f}\n"
                f"set bmargin at screen {1 - bottom / h:.5f}\nset logscale xy\nset grid lc rgb '#e0e0e0'\nunset key\nset xrange [{self.x[0]}:{self.x[1]}]\nset yrange [{self.y[0]}:{self.y[1]}]\n"
                f"set title {self.quoted(title)} font ',13' offset 0,-0.4\nset xlabel '{x_label}' offset 0,0.4\nset ylabel '{y_label}' offset 0.5,0\nset xtics ({x_tics}) nomirror\nunset mxtics\nunset mytics\n"
                + ("set format y '10^{%L}'\nset ytics nomirror\n" if y_tics else "set format y ''\nset ytics nomirror\n")
                + self.data + self.settings + "plot " + ", ".join(self.plots) + "\n")


def size_of(worst):
    """Of a mark: it grows with the wrong rays."""
    return min(2.2, 0.75 + 0.28 * math.log10(1 + worst))


def shape_of(point):
    hollow = point["worst"] > HOLLOW_PPM
    return (8 if hollow else 9) if point["precision"] == "f32" else (6 if hollow else 7)


def draw_methods(panel, points, cost, joined):
    """Every method at (cost, error); each solve in its colour. Those that are nearly always wrong first, below the others."""
    for p in points:
        p["place"] = (p[cost], p["p99"])
    for solve, precision in [(s, p) for s in SOLVES for p in ("f64", "f32") if joined]:
        curve = sorted((p for p in points if (p["solve"], p["precision"]) == (solve, precision)), key=lambda p: p["steps"])
        if len(curve) > 1:
            panel.line([p["place"] for p in curve], f"lines lw 1.5 dt {1 if precision == 'f64' else 3} lc rgb '{COLOURS[solve]}'")
    for p in sorted(points, key=lambda p: -p["worst"]):
        panel.mark(*p["place"], shape_of(p), size_of(p["worst"]) * (1 if p["precision"] == "f64" else 0.85), COLOURS[p["solve"]])


def draw_auto(panel, point, cost, words):
    """Last, so that nothing lies over it."""
    x, y = point[cost], point["p99"]
    panel.add([(x, y)], "using 1:2 with points pt 7 ps 2.6 lc rgb '#ffffff'")
    panel.add([(x, y)], "using 1:2 with points pt 6 ps 2.6 lw 1.5 lc rgb 'black'")
    panel.mark(x, y, 3, 1.7, "black")
    panel.label(words, x, y, "black", 12, 12)


def words_of(point):
    return f"{point['solve']} {point['steps'] or ''} {point['precision']}".replace("  ", " ")


def draw_front(panel, points, cost):
    front = [(p[cost], p["p99"]) for p in pareto(points, cost)]
    steps = [place for at, after in zip(front, front[1:]) for place in (at, (after[0], at[1]))] + front[-1:]
    if steps:
        panel.line(steps, "lines lw 2 dt 2 lc rgb '#444444'")


def draw_peers(panel, peers):
    for p in peers:
        words, colour, mark = PEER_STYLES[p["tracer"]]
        panel.mark(p["ratio"], p["p99"], mark - (p["worst"] > HOLLOW_PPM), size_of(p["worst"]), colour)
    for p in peers:
        words, colour, _ = PEER_STYLES[p["tracer"]]
        panel.label(f"{words}, {p['bytes'] / 1e6:.1f} MB" if "bytes" in p else words, p["ratio"], p["p99"], colour, 10, 9)


def draw_default_line(panel):
    panel.add([(1, panel.y[0]), (1, panel.y[1])], "with lines lc rgb '#bbbbbb'")


def field_peers(table, field, size):
    return [{**p, "bytes": int(p["row"]["bytes"])} for p in peers_of(table, field, size)]


PEER_AXIS = (0.8, 40)
PEER_TICS = "'1' 1, '2' 2, '5' 5, '10' 10, '20' 20"


def draw_field(table, size, box, field, voxels, cost, label, number_of):
    """The methods in one field; with times also the others, in a narrow panel of their own that has another axis."""
    left, top, right, bottom = box
    points = methods_of(table, field, voxels)
    peers = field_peers(table, field, voxels) if cost == "ns" else []
    middle = right - 190 if peers else right
    low, high = min(p[cost] for p in points), max(p[cost] for p in points)
    x = (low / (high / low) ** 0.12, high * (high / low) ** 0.2)
    panel = Panel(f"m{number_of}", size, (left, top, middle, bottom), x, ERRORS)
    floor, pixel = floors(table, field, voxels)
    for level, colour, words in ((floor, FIELD_COLOUR, "field error"), (pixel, PIXEL_COLOUR, "half a pixel")):
        if level > 0:
            panel.level(level, colour, words, above=level == max(floor, pixel))
    draw_front(panel, points, cost)
    draw_methods(panel, points, cost, joined=cost == "instructions")
    auto = auto_of(table, points, field, voxels)
    if auto:
        draw_auto(panel, auto, cost, f"auto: {words_of(auto)}")
    for solve in reversed(SOLVES):  # each name once, at its most exact point in double
        named = [p for p in points if p["solve"] == solve and p["precision"] == "f64"]
        if named:
            at = min(named, key=lambda p: (p["p99"], -p["steps"])) if solve != "robust" else max((p for p in named if p["steps"] == 3), key=lambda p: p["p99"])
            panel.label(solve, *at["place"], COLOURS[solve])
    script = panel.script(f"{field} {voxels}", label, "p99 depth error, voxels", axis_tics(low, high))
    if not peers:
        return script
    strip = Panel(f"p{number_of}", size, (middle + 12, top, right, bottom), PEER_AXIS, ERRORS)
    draw_default_line(strip)
    for level, colour in ((floor, FIELD_COLOUR), (pixel, PIXEL_COLOUR)):
        if level > 0:
            strip.level(level, colour, "")
    draw_peers(strip, peers)
    return script + strip.script("mesh, OpenCL", "time / the default", "", PEER_TICS, y_tics=False)


def draw_pareto(table, folder, name, cost, label):
    fields = [f for f in table.fields() if methods_of(table, *f)]
    columns, width, row = 2, 1260, 330
    lines = math.ceil((len(fields) + 1) / columns)
    size = (width, row * lines)
    body = "set multiplot\n"
    for n, (field, voxels) in enumerate(fields):
        left, top = n % columns * width / columns, n // columns * row
        body += draw_field(table, size, (left + 75, top + 36, left + width / columns - 15, top + row - 50), field, voxels, cost, label, n)
    n = len(fields)
    body += legend(size, n % columns * width / columns + 75, n // columns * row + 40, cost == "ns")
    both_formats(folder, name, *size, body + "unset multiplot\n")


def legend(size, left, top, with_peers):
    """What the marks mean; colours are named at the points."""
    panel = Panel("legend", size, (left, top, left + 400, top + 240), (1, 10), (1, 10))
    rows = [("points pt 7 ps 1.2 lc rgb '#666666'", "solved in double (f64); a curve: more steps downwards" if not with_peers else "solved in double (f64)"),
            ("points pt 9 ps 1.2 lc rgb '#666666'", "solved in float (f32)"),
            ("points pt 6 ps 1.9 lc rgb '#666666'", f"hollow: more than {HOLLOW_PPM} of 1e6 rays are wrong; larger: more of them"),
            ("points pt 3 ps 1.7 lc rgb 'black'", "what --quality auto takes in this view"),
            ("lines lw 2 dt 2 lc rgb '#444444'", "Pareto front of the methods without wrong rays"),
            (f"lines dt 3 lw 2 lc rgb '{FIELD_COLOUR}'", "the field's own error (median)"),
            (f"lines dt 3 lw 2 lc rgb '{PIXEL_COLOUR}'", "half a pixel of 1024 rows: less cannot be seen")]
    if with_peers:
        rows += [("points pt 5 ps 1.2 lc rgb '#8c510a'", "others: marching-cubes mesh (Embree, OpenGL), OpenCL device")]
    for n, (style, words) in enumerate(rows):
        y = top + 12 + 25 * n
        at = 10 ** ((top + 240 - y) / 240)
        ends = [(1.02, at), (1.12, at)] if style.startswith("lines") else [(1.07, at)]
        panel.add(ends, "using 1:2 with " + style)
        panel.text(words, left + 34, y, "black", 12, "left")
    return panel.script().replace("plot ", "unset grid\nunset border\nunset xtics\nunset ytics\nplot ") + "set border\n"


def draw_overview(table, folder):
    """All fields in one: cost to the default's (median of fields) against the worst error, with the names of all curves."""
    points = over_all_fields(table)
    counted = cost_column(table) == "instructions_per_ray"
    size, top, bottom = (1260, 640), 40, 580
    costs = [("instructions", "instructions, relative to the default", 75, 560)] * counted + [("ns", "time, relative to the default", 590 if counted else 75, 950)]
    body = "set multiplot\n"
    for n, (cost, label, left, right) in enumerate(costs):
        low, high = min(p[cost] for p in points), max(p[cost] for p in points)
        panel = Panel(f"o{n}", size, (left, top, right, bottom), (low / (high / low) ** 0.3, high * (high / low) ** 0.35), WORST_ERRORS)
        draw_default_line(panel)
        draw_overview_floors(panel, table, n == 0)
        draw_front(panel, points, cost)
        draw_methods(panel, points, cost, joined=cost == "instructions")
        name_methods(panel, points, table, cost)
        tics = ", ".join(f"'{t}' {t}" for t in (0.8, 0.9, 1, 1.1, 1.2, 1.3, 1.4, 1.6) if panel.x[0] < t < panel.x[1])
        title = {"instructions": "Methods, in instructions", "ns": "Methods, by the clock"}[cost]
        body += panel.script(title, label + " (median)", "worst p99 depth error of all fields, voxels" if n == 0 else "", tics, y_tics=n == 0)
    body += draw_overview_peers(table, size, (980, top, 1245, bottom))
    both_formats(folder, "overview", *size, body + "unset multiplot\n")


def draw_overview_floors(panel, table, with_words):
    known = [floors(table, *f) for f in table.fields() if methods_of(table, *f)]
    pixel = min(p for _, p in known)
    panel.level(pixel, PIXEL_COLOUR, "half a pixel" if with_words else "")
    panel.level(pixel / 10, PIXEL_COLOUR, "a tenth: no method need be better" if with_words else "")


def name_methods(panel, points, table, cost):
    default = default_of(points)
    draw_auto(panel, default, cost, "the default, and auto" if all_autos_default(table) else "the default; auto in most fields")
    for solve in reversed(SOLVES):
        for precision in ("f64", "f32"):
            curve = [p for p in points if (p["solve"], p["precision"]) == (solve, precision)]
            if not curve:
                continue
            wrong = [p["worst"] for p in curve if p["worst"] > HOLLOW_PPM]
            words = solve + (" f32" if precision == "f32" else "")
            if wrong and len(wrong) == len(curve):
                words += f": {max(wrong) / 1e4:.2g} % wrong"
            if cost == "instructions" or precision == "f64":
                at = min(curve, key=lambda p: p["p99"]) if solve != "robust" or precision == "f32" else next(p for p in curve if p["steps"] == 6)
                panel.label(words, *at["place"], COLOURS[solve])
    for p in points:
        if cost == "instructions" and p["steps"] and p["precision"] == "f64" and p["solve"] in ("robust", "marmitt"):
            panel.label(str(p["steps"]), *p["place"], COLOURS[p["solve"]], 9, 4)


def all_autos_default(table):
    for field, voxels in table.fields():
        points = methods_of(table, field, voxels)
        auto = auto_of(table, points, field, voxels)
        if auto and key_of(auto) != DEFAULT:
            return False
    return True


def draw_overview_peers(table, size, box):
    """The median of the fields, and a line from the least to the most."""
    panel = Panel("op", size, box, PEER_AXIS, WORST_ERRORS)
    draw_default_line(panel)
    draw_overview_floors(panel, table, False)
    found = {}
    for field, voxels in table.fields():
        for p in peers_of(table, field, voxels):
            found.setdefault(p["tracer"], []).append(p)
    for tracer, ps in found.items():
        _, colour, mark = PEER_STYLES[tracer]
        ratios, error, worst = [p["ratio"] for p in ps], max(p["p99"] for p in ps), max(p["worst"] for p in ps)
        panel.line([(min(ratios), error), (max(ratios), error)], f"lines lw 1.5 lc rgb '{colour}'")
        panel.mark(median(ratios), error, mark - (worst > HOLLOW_PPM), size_of(worst), colour)
    for tracer, ps in found.items():
        words, colour, _ = PEER_STYLES[tracer]
        ratio, worst = median([p["ratio"] for p in ps]), max(p["worst"] for p in ps)
        wrong = f", {worst / 1e4:.2g} % wrong" if worst > HOLLOW_PPM else ""
        panel.label(f"{words}{' device' if tracer == 'opencl' else ', mesh'}: {ratio:.1f} times{wrong}", ratio, max(p["p99"] for p in ps), colour, 11, 9)
    if not found:
        return ""
    return panel.script("Others, by the clock", "time, relative to the default (median, range)", "", PEER_TICS, y_tics=False)


def draw_storage(table, folder):
    """A panel a field: what a structure and a sample type store, and what is left of the surface."""
    fields = list(dict.fromkeys((r["field"], r["size"]) for r in table.select(kind="storage")))
    if not fields:
        return
    columns, width, row = 3, 1260, 290
    size = (width, row * math.ceil(len(fields) / columns))
    shades, marks = {"f32": "#0072b2", "u16": "#008a60", "u8": "#d55e00"}, {"dense": 7, "bricks": 5, "adf": 9}
    body = "set multiplot\n"
    for n, (field, voxels) in enumerate(fields):
        rows = table.select(kind="storage", field=field, size=voxels)
        left, top = n % columns * width / columns, n // columns * row
        low, high = min(int(r["bytes"]) for r in rows), max(int(r["bytes"]) for r in rows)
        panel = Panel(f"s{n}", size, (left + 70, top + 36, left + width / columns - 10, top + row - 50), (low / 1.9, high * 1.9), (3e-7, 500))
        points = []
        for r in rows:
            cubic = r["tracer"] == "tricubic"
            words = "dense f32, tricubic" if cubic else f"{r['structure']} {r['samples']}".replace("adf", "octree")
            colour = "black" if cubic else shades[r["samples"]]
            points.append((int(r["bytes"]), max(number(r["depth_p99"]), 1e-6), words, colour))
            panel.mark(*points[-1][:2], 3 if cubic else marks[r["structure"]], 1.3, colour)
        for x, y, words, colour in points:
            panel.label(words, x, y, colour, 10, 8)
        tics = ", ".join(f"'{t // 1000} kB' {t}" for t in (50000, 100000, 200000, 500000, 1000000, 2000000, 5000000, 10000000) if panel.x[0] * 1.1 < t < panel.x[1] / 1.3)
        body += panel.script(f"{field} {voxels}", "", "p99 error, voxels" if n % columns == 0 else "", tics)
    both_formats(folder, "storage", *size, body + "unset multiplot\n")


def draw_gradients(table, folder):
    """A table that is coloured: the error of each gradient in each field, and its time."""
    fields = [f for f in table.fields() if len(table.select(kind="gradient", field=f[0], size=f[1])) >= len(GRADIENTS)]
    if not fields:
        return
    cells, labels = [], ""
    for y, gradient in enumerate(GRADIENTS):
        for x, (field, voxels) in enumerate(fields):
            value = number(table.select(kind="gradient", field=field, size=voxels, gradient=gradient)[0]["normal_p99"])
            cells.append((x, y, math.log10(max(value, 1e-3))))
            labels += f"set label \"{value:.0f}\" at {x},{y} center front font ',12'\n" if value >= 10 else f"set label \"{value:.2g}\" at {x},{y} center front font ',12'\n"
    data = "$cells << EOD\n" + "".join(f"{x} {y} {v}\n" for x, y, v in cells) + "EOD\n"
    x_tics = ", ".join(f"'{f} {v}' {x}" for x, (f, v) in enumerate(fields))
    y_tics = ", ".join(f"'{g}{' (default)' if g == 'corner-central' else ''}' {y}" for y, g in enumerate(GRADIENTS))
    both_formats(folder, "gradients", 900, 420, data + labels + f"set title 'p99 angle to the exact normal, degrees'\nset xtics ({x_tics}) scale 0 noenhanced\nset ytics ({y_tics}) scale 0\n"
                 f"set xrange [-0.5:{len(fields) - 0.5}]\nset yrange [{len(GRADIENTS) - 0.5}:-0.5]\nunset key\nunset colorbox\nset cbrange [-3:2.3]\n"
                 "set palette defined (0 '#a6dba0', 0.45 '#ffffff', 1 '#f4a582')\nplot $cells using 1:2:3 with image\n")


def draw_all(table, folder):
    draw_overview(table, folder)
    draw_pareto(table, folder, "pareto", "ns", "ns/ray")
    if cost_column(table) == "instructions_per_ray":
        draw_pareto(table, folder, "pareto-instructions", "instructions", "instructions/ray")
    draw_storage(table, folder)
    draw_gradients(table, folder)
