"""What the bench pipelines share: fields made once, df-render --bench in interleaved runs, CSV."""
import csv
import io
import lzma
import os
import shutil
import statistics
import subprocess
import sys
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
BIN = os.path.join(ROOT, "build", "release")
RENDER = os.path.join(BIN, "render", "df-render")
CONVERT = os.path.join(BIN, "convert", "df-convert")
SHARED = os.path.join(ROOT, "..", "shared", "meshes", "stanford")
MESHES = {
    "bunny": "/usr/share/glmark2/models/bunny.obj",
    "dragon": os.path.join(SHARED, "dragon_vrip.ply.xz"),
    "buddha": os.path.join(SHARED, "buddha_100k.obj.xz"),
}


def have(name):
    """Whether a mesh is there; says so when it is not."""
    if os.path.exists(MESHES[name]):
        return True
    print(f"skipped: {name} ({MESHES[name]} is not there)")
    return False


def mesh(folder, name):
    """The path of a mesh, unpacked where it is not."""
    packed = MESHES[name]
    if not packed.endswith(".xz"):
        return packed
    os.makedirs(folder, exist_ok=True)
    plain = os.path.join(folder, os.path.basename(packed)[:-3])
    if not os.path.exists(plain):
        with lzma.open(packed) as source, open(plain + ".part", "wb") as target:
            shutil.copyfileobj(source, target)
        os.rename(plain + ".part", plain)
    return plain


def field(folder, name, resolution, *options):
    """The path of a field of a mesh, converted unless it is there already."""
    os.makedirs(folder, exist_ok=True)
    tag = "".join(options).replace("--", "_").replace("=", "")
    path = os.path.join(folder, f"{name}_{resolution}{tag}.dfield")
    if not os.path.exists(path):
        subprocess.run([CONVERT, mesh(folder, name), "--resolution", str(resolution), *options, "-q", "-o", path], check=True, stdout=subprocess.DEVNULL)
    return path


def process(command):
    """Runs a command: what it prints, its time, its processor time and its peak memory. Raises RuntimeError with its text where it fails."""
    begin = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as child:
        text = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)  # so that Popen does not wait for it again
    if child.returncode:
        raise RuntimeError(f"{' '.join(command)}: {text.strip()}")
    return {"text": text, "seconds": time.monotonic() - begin, "cpu_seconds": usage.ru_utime + usage.ru_stime, "peak_bytes": usage.ru_maxrss * 1024}


def bench(path, *options, frames=36, repeats=1):
    """One run of df-render --bench as a dictionary of strings."""
    out = subprocess.run([RENDER, path, f"--bench={frames}", "--repeats", str(repeats), *options], check=True, capture_output=True, text=True)
    return next(csv.DictReader(io.StringIO(out.stdout)))


def interleaved(runs, repeats, frames):
    """Runs {name: (path, options)} one after the other, `repeats` times; returns {name: [rows]}."""
    rows = {name: [] for name in runs}
    for _ in range(repeats):
        for name, (path, options) in runs.items():
            rows[name].append(bench(path, *options, frames=frames))
    return rows


def median(rows, column):
    return statistics.median(float(row[column]) for row in rows)


LOOP = """
import sys, time
sys.stdin.readline()  # all start together
begin, x = time.perf_counter(), 1
for _ in range(int(sys.argv[1])): x = x * 1103515245 + 12345 & 0x7fffffff
print(time.perf_counter() - begin)
"""


def compute_rate(processes, rounds=4_000_000):
    """Rounds a second of a loop without memory, run by so many processes at once: what the machine's cores give at best."""
    loops = [subprocess.Popen([sys.executable, "-c", LOOP, str(rounds)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(processes)]
    for loop in loops:
        loop.stdin.write("\n")
        loop.stdin.flush()
    return sum(rounds / float(loop.communicate()[0]) for loop in loops)


def draw_bars(path, title, times):
    """A chart of {label: ms} as path.svg; says so where gnuplot is missing."""
    if not shutil.which("gnuplot"):
        print(f"skipped: {path}.svg (no gnuplot)")
        return
    rows = "\n".join(f'{i} {ms:.6g} "{label}"' for i, (label, ms) in enumerate(times.items()))
    script = f"""set terminal svg size {max(480, 60 + 44 * len(times))},420 dynamic font 'sans,12' background '#ffffff'
set output '{path}.svg'
set title '{title}' noenhanced
set ylabel 'ms a frame'
set yrange [0:*]
set grid ytics
set style fill solid
set boxwidth 0.7
set xtics rotate by -40 noenhanced
$times << END
{rows}
END
plot $times using 1:2:xtic(3) with boxes lc rgb '#0072b2' notitle
"""
    subprocess.run(["gnuplot"], input=script, text=True, check=True)


def write_csv(path, rows):
    with open(path, "w", newline="") as out:
        writer = csv.DictWriter(out, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
