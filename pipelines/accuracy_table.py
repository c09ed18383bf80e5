"""The table of pipelines/accuracy, and what it says of methods, of others and of --quality auto: for accuracy_charts.py and accuracy_report.py."""
import csv
import math
import sys

SOLVES = ["midpoint", "linear", "repeated", "marmitt", "analytic", "robust"]
GRADIENTS = ["analytic", "central", "forward", "backward", "corner-central", "corner-forward", "c0", "crease"]
PEERS = ["mc-embree", "mc-raster", "opencl"]
DEFAULT = ("robust", 16, "f64")
LEAST = 1e-15  # smaller errors are taken for this
HOLLOW_PPM = 10
NEAR = 1.10  # how far --quality auto may be off the front


def number(text):
    return float(text) if text else math.nan


def median(values):
    return sorted(values)[len(values) // 2]


class Table:
    def __init__(self, path):
        with open(path, newline="") as file:
            self.rows = list(csv.DictReader(file))
        if not self.rows:
            sys.exit(f"accuracy_report: {path}: no rows")
        self.by_kind = {}
        for r in self.rows:
            self.by_kind.setdefault(r["kind"], []).append(r)

    def select(self, kind, **wanted):
        return [r for r in self.by_kind.get(kind, []) if all(r[k] == v for k, v in wanted.items())]

    def fields(self):
        seen = []
        for r in self.rows:
            key = (r["field"], r["size"])
            if r["kind"] == "solve-time" and key not in seen:
                seen.append(key)
        return seen


def errors_ppm(row):
    """Of the rays that were traced for errors, which are not those of the picture that was timed."""
    rays = sum(int(row[c]) for c in ("tangent", "true_positive", "false_positive", "false_negative", "true_negative"))
    return 1e6 * sum(int(row[c]) for c in ("false_positive", "false_negative", "leaks", "wrong_face")) / rays


def key_of(point):
    return point["solve"], point["steps"], point["precision"]


def methods_of(table, field, size):
    """For each method: cost, p99 depth error in voxels over the camera's rays, and the worst of all families in wrong rays, ppm."""
    def methods(kind, **wanted):
        found = {}
        for r in table.select(kind, field=field, size=size, **wanted):
            found.setdefault((r["intersect"], r["steps"], r["precision"]), []).append(r)
        return found
    points, all_times, all_families = [], methods("solve-time"), methods("solve", truth="field")
    for key, (row, *_) in methods("solve", truth="field", family="camera").items():
        times, families = all_times.get(key), all_families[key]
        if not times:
            continue
        points.append({"solve": row["intersect"], "precision": row["precision"], "steps": int(row["steps"]), "ns": number(times[0]["ns_per_ray"]),
                       "instructions": number(times[0]["instructions_per_ray"]), "p99": max(number(row["depth_p99"]), LEAST),
                       "worst": max(errors_ppm(r) for r in families)})
    return points


def default_of(points):
    return next(p for p in points if key_of(p) == DEFAULT)


def over_all_fields(table):
    """For each method: its cost to the default's (median of fields), and the worst p99 and wrong rays of all fields, with where."""
    found = {}
    for field, size in table.fields():
        points = methods_of(table, field, size)
        if not points:
            continue
        default = default_of(points)
        for p in points:
            ratios = {cost: p[cost] / default[cost] for cost in ("ns", "instructions")}
            found.setdefault(key_of(p), []).append({**p, **ratios, "field": field})
    everything = []
    for key, ps in found.items():
        inexact, wrong = max(ps, key=lambda p: p["p99"]), max(ps, key=lambda p: p["worst"])
        everything.append({"solve": key[0], "steps": key[1], "precision": key[2], "ns": median([p["ns"] for p in ps]), "instructions": median([p["instructions"] for p in ps]),
                           "p99": inexact["p99"], "p99_field": inexact["field"], "worst": wrong["worst"], "worst_field": wrong["field"]})
    return everything


def pareto(points, cost):
    """The points that no other beats in cost and error, among those without errors."""
    sound = [p for p in points if p["worst"] <= HOLLOW_PPM]

    def beats(q, p):
        return q[cost] <= p[cost] and q["p99"] <= p["p99"] and (q[cost] < p[cost] or q["p99"] < p["p99"])
    return sorted((p for p in sound if not any(beats(q, p) for q in sound)), key=lambda p: p[cost])


def cost_column(table):
    """What choices are judged by: instructions, which repeat, where they were counted; otherwise the clock."""
    counted = all(r["instructions_per_ray"] for r in table.select(kind="auto") + table.select(kind="front"))
    return "instructions_per_ray" if counted else "ns_per_ray"


def choices(table):
    """For each view: the row of --quality auto, its wrong rays, and its cost against the cheapest that is sound there and no less
    exact (the front), and against the cheapest within its bound, which only somebody who knows the truth could choose."""
    cost, found = cost_column(table), []
    for row in table.select(kind="auto"):
        front = table.select(kind="front", field=row["field"], size=row["size"], family=row["family"])
        if not front:
            continue
        sound = [r for r in front if errors_ppm(r) == 0]

        def least(error):
            return min([number(r[cost]) for r in sound if number(r["depth_p99"]) <= error], default=number(row[cost]))
        clock = number(row["contender_ratio"]) if row["contender_ratio"] else 1.0
        ratio = number(row[cost]) / least(number(row["depth_p99"])) if cost == "instructions_per_ray" else clock
        found.append({"row": row, "wrong": errors_ppm(row), "ratio": ratio, "clock_ratio": clock,
                      "bound_ratio": number(row[cost]) / least(number(row["bound"]))})
    return found


def auto_of(table, points, field, size):
    """The method that --quality auto takes in the chart's view, as a point of the chart: the frames are those of that method. None: not measured."""
    rows = table.select(kind="auto", field=field, size=size, family="distance 1.6")
    keys = [(r["intersect"], int(r["steps"]), r["precision"]) for r in rows]
    return next((p for p in points if key_of(p) in keys), None)


def floors(table, field, size):
    rows = table.select(kind="solve", field=field, size=size, family="camera", truth="field")
    floor = number(rows[0]["field_floor"]) if rows else 0
    pixel = 0.5 * 1.6 * int(size) * 2 * math.tan(0.5) / 1024  # half a pixel at the middle of a picture of 1024 rows
    return floor, pixel


def peers_of(table, field, size):
    """The marching-cubes mesh and devices: the tracer, its time to the default's in the same turns, p99 depth error, wrong rays in ppm, and the row."""
    rows = table.select(kind="peer", field=field, size=size)
    own = [number(r["ns_per_ray"]) for r in rows if r["tracer"] not in PEERS]
    return [{"tracer": r["tracer"], "ratio": number(r["ns_per_ray"]) / own[0], "p99": max(number(r["depth_p99"]), LEAST), "worst": errors_ppm(r), "row": r}
            for r in rows if r["tracer"] in PEERS and own]


KEY = ["kind", "field", "size", "structure", "samples", "tracer", "intersect", "steps", "precision", "gradient", "truth", "family", "rays"]
TIMES = ["ns_per_ray", "ns_per_hit", "contender", "contender_ratio"]


def differences(one, other):
    """Two runs, column by column, without times and what hangs on them: the keys of rows that only one has, how many both
    have, and by column the keys and values that differ. Instructions by a processor's own counter are as good as times."""
    found = [{tuple(r[k] for k in KEY): r for r in table.rows} for table in (one, other)]
    both = [key for key in found[0] if key in found[1]]
    differing = {}
    for key in both:
        a, b = found[0][key], found[1][key]
        for column in a:
            counted = column == "instructions_per_ray" and "counter" in (a["counted"], b["counted"])
            if column not in TIMES and not counted and a[column] != b[column]:
                differing.setdefault(column, []).append((key, (a[column], b[column])))
    return [key for key in list(found[0]) + list(found[1]) if not (key in found[0] and key in found[1])], len(both), differing
