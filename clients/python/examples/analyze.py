"""Lists the defects of models without a repair: python analyze.py http://127.0.0.1:8080 a.stl b.stl"""

import sys

from meshmend import Client

address, *paths = sys.argv[1:]
job = Client(address).analyze(*paths)
for file in job.analysis["files"]:
    found = [f"{group['count']} {group['kind']}" for group in file["inspection"]["defects"]]
    print(f"{file['name']}: {'printable' if file.get('printable') else 'not printable'}", *found)
