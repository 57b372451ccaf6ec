"""The measuring plan of a campaign: timetable, NC programs, empty tables, and what the plan will be able to see."""
