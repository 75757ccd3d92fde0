"""Agreement on a plan and on distinct slots in it: the subject of the paper."""
