"""The main job end to end: a recording plays, the nodes identify the DLO, a report is made."""
