"""`hir bench`: time, memory and error of the installed components at growing sizes, compared with slow references."""
